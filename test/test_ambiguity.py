"""Frames of a box tell nothing of a half turn, those of an irregular target do."""

import pytest
from posed_frames import tumbling

from debris_scanner.ambiguity import looks_alike_turned
from debris_scanner.fusion import FusionSettings
from debris_scanner.refinement import fuse


@pytest.mark.slow
@pytest.mark.parametrize(('target', 'alike'), [('prism', True), ('cubesat', False), ('shuttle_stack', False)])
def test_a_half_turn_of_a_box_can_not_be_seen(target, alike):
    frames = tumbling(target)
    assert looks_alike_turned(fuse(frames, FusionSettings()), frames) is alike
