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

"""Key frames that show a half hidden target, though odometry took them for whole: the others tell.

What came into sight behind a shadow's edge had never been seen, so nothing was missed. Once loops are closed
other key frames show it: a part of them lies beside this one's silhouette, while nothing of this one
contradicts them. Of a frame that is out of place something would.
"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.geometry import Array
from debris_scanner.registration import linearise
from debris_scanner.views import View, angles_between

REACH = np.radians(70.0)  # other views from so near are asked,
WITNESSES = 12  # at most
TELLING = 2  # and so many must tell
MISSING = 0.15  # of their points that should show, beside the silhouette
AGREE_OUTSIDE, AGREE_FREE = 0.06, 0.035  # and of its own points, which lie where they have them,
AGREE_RMS = 0.0023  # m
MOST = 0.25  # of the views: more, and it is the poses that are wrong
GATE = 0.012  # m


def occluded_views(views: Sequence[View], poses: Sequence[Array]) -> set[int]:
    """Indices of the views (T_target_view (4, 4) each) of which the others show that a part is hidden."""
    angles = angles_between(views, poses)
    occluded = set()
    for k in range(len(views)):
        near = [int(m) for m in np.argsort(angles[k], kind='stable') if m != k and angles[k, m] < REACH]
        telling = 0
        for m in near[:: max(1, len(near) // WITNESSES)]:  # not the latest alone: they are hidden alike
            telling += _tells(views[m], poses[m], views[k], poses[k])
            if telling == TELLING:
                occluded.add(k)
                break
    return occluded if len(occluded) <= MOST * len(views) else set()


def _tells(other: View, T_other: Array, view: View, T_view: Array) -> bool:
    """Whether another view shows that something is hidden in this one, and contradicts nothing of it."""
    seen = linearise(other, T_other, view, T_view, GATE).agreement
    missing = seen.outside_mask / max(1.0, seen.visible + seen.outside_mask)
    if missing < MISSING or seen.free_space > AGREE_FREE:
        return False
    own = linearise(view, T_view, other, T_other, GATE).agreement
    return own.outside < AGREE_OUTSIDE and own.free_space < AGREE_FREE and own.rms < AGREE_RMS
