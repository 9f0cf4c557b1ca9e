# Copyright 2026 debris_scanner maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Frames of a box tell nothing of a half turn, those of an irregular target do."""

import pytest
from posed_frames import tumbling

from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.modelling.symmetry import looks_alike_turned


@pytest.mark.slow
@pytest.mark.parametrize(('target', 'alike'), [('prism', True), ('cubesat', False), ('shuttle_stack', False)])
def test_a_half_turn_of_a_box_can_not_be_seen(target, alike):
    frames = tumbling(target)
    assert looks_alike_turned(fuse(frames, FusionSettings()), frames) is alike
