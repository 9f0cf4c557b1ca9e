"""Frames of a box tell nothing of a half turn, those of an irregular target do."""

import numpy as np
import pytest

from debris_scanner.ambiguity import looks_alike_turned
from debris_scanner.frames import DepthFrame, FrameRejected
from debris_scanner.fusion import FusionSettings
from debris_scanner.geometry import inverse
from debris_scanner.refinement import fuse
from debris_scanner.scanner import make_preprocessor
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings


def posed(target):
    """Frames of a tumble at their true poses."""
    preprocessor = make_preprocessor(Settings())
    frames = []
    for f in Simulation(SimulationSettings(target=target, motion='tumble', seconds=60.0, rate_hz=1.5)):
        try:
            seen = preprocessor.process(DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera))
        except FrameRejected:  # still finding out what the target is
            continue
        frames.append((seen, inverse(f.T_sensor_target)))
    return frames


@pytest.mark.slow
@pytest.mark.parametrize(('target', 'alike'), [('prism', True), ('cubesat', False), ('shuttle_stack', False)])
def test_a_half_turn_of_a_box_can_not_be_seen(target, alike):
    frames = posed(target)
    assert looks_alike_turned(fuse(frames, FusionSettings()), frames) is alike
