"""Fits of a frame as the figures say."""

import numpy as np

from debris_scanner.frame_fit import FrameFit
from debris_scanner.motion_filter import MotionFilter, MotionSettings
from debris_scanner.registration import Agreement


def fit(overlap=0.95, explained=0.95, missing=0.0, rms=0.0015, free=0.0, outside=0.0):
    agreement = Agreement(
        points=1000.0,
        matched=900.0,
        square=900.0 * rms**2,
        visible=1000.0,
        in_free_space=1000.0 * free,
        outside_mask=1000.0 * outside,
    )
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings())
    return FrameFit(motion, agreement, 0.1, overlap, explained, missing)
