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

"""Fits of a frame as the figures say."""

import numpy as np

from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.tracking.gating import FrameFit
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings


def fit(
    overlap=0.95,
    visible_inlier_ratio=0.95,
    missing_reference_ratio=0.0,
    rms=1.0,  # px
    free=0.0,
    silhouette_violation_ratio=0.0,
):
    stats = RegistrationStats(
        points=1000.0,
        matched=900.0,
        square=900.0 * rms**2,
        visible=1000.0,
        in_free_space=1000.0 * free,
        outside_mask=1000.0 * silhouette_violation_ratio,
    )
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
    return FrameFit(motion, stats, 0.1, overlap, visible_inlier_ratio, missing_reference_ratio)
