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

"""Partially occluded key frames that odometry took for unoccluded, by what the relaxed poses reveal.

What came into sight behind an occluding edge had never been seen, so nothing was missing. Other views show
points beside such a key frame's silhouette, while none of its own points contradicts them, as they would at a
wrong pose.
"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.mapping.relaxation import GATES
from debris_scanner.registration.projective import linearise
from debris_scanner.sensing.views import View, angles_between

# Of at most WITNESSES other views within REACH, MIN_WITNESSES must show it.
REACH = np.radians(70.0)
WITNESSES = 12
MIN_WITNESSES = 2
MIN_MISSING_RATIO = 0.15  # share of the witness's visible points beside the view's silhouette
MAX_SILHOUETTE_VIOLATION = 0.06  # of the view's own points in the witness
MAX_CONFLICT_RATIO = 0.035
MAX_RMS = 1.55  # px
MAX_OCCLUDED_SHARE = 0.25  # of the views; beyond, the poses are wrong


def partially_occluded_views(views: Sequence[View], poses: Sequence[Array]) -> set[int]:
    """Indices of the views, posed by T_target_view (4, 4), that other views show to be partially occluded."""
    angles = angles_between(views, poses)
    occluded = set()
    for k in range(len(views)):
        near = [int(m) for m in np.argsort(angles[k], kind='stable') if m != k and angles[k, m] < REACH]
        witnesses = 0
        for m in near[:: max(1, len(near) // WITNESSES)]:  # spread: neighbours in time are occluded alike
            witnesses += _shows_occlusion(views[m], poses[m], views[k], poses[k])
            if witnesses == MIN_WITNESSES:
                occluded.add(k)
                break
    return occluded if len(occluded) <= MAX_OCCLUDED_SHARE * len(views) else set()


def _shows_occlusion(other: View, T_other: Array, view: View, T_view: Array) -> bool:
    """Whether another view has points that are occluded in this one, and contradicts none of its points."""
    seen = linearise(other, T_other, view, T_view, GATES[0]).stats
    missing = seen.outside_mask / max(1.0, seen.visible + seen.outside_mask)
    if missing < MIN_MISSING_RATIO or seen.conflict_ratio > MAX_CONFLICT_RATIO:
        return False
    own = linearise(view, T_view, other, T_other, GATES[0]).stats
    return (
        own.silhouette_violation_ratio < MAX_SILHOUETTE_VIOLATION
        and own.conflict_ratio < MAX_CONFLICT_RATIO
        and own.rms < MAX_RMS
    )
