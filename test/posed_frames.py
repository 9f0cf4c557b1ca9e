"""Frames of simulated targets at their true poses."""

import numpy as np

from debris_scanner.frames import DepthFrame, FrameRejected
from debris_scanner.geometry import inverse
from debris_scanner.scanner import make_preprocessor
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings


def tumbling(target):
    """Target frames of a tumble and T_target_sensor."""
    preprocessor = make_preprocessor(Settings())
    frames = []
    for f in Simulation(SimulationSettings(target=target, motion='tumble', seconds=60.0, rate_hz=1.5)):
        try:
            seen = preprocessor.process(DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera))
        except FrameRejected:  # still finding out what the target is
            continue
        frames.append((seen, inverse(f.T_sensor_target)))
    return frames
