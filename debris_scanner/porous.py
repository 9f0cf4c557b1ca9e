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

"""Porous depth images: of a surface that returns light from some of its pixels only.

Shiny insulation is such a surface (Trowbridge 2014, 1.2.6 and 6.2.3): what faces the sensor returns from
one pixel in two or three, what is turned away from none. Its planes are fitted through the pores, and a
pixel that returns nothing is evidence of nothing.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from debris_scanner.silhouette import Mask, closed

Image = NDArray[np.float32]

OUTLINE_REACH_PX = 2
PORES = 0.5  # share of the outline that returns nothing: 0.6 of insulation, at most 0.4 of anything else
FILL_REACH_PX = 3
LEAST_NEIGHBOURS = 4


def outline(depth: Image) -> Mask:
    """What a depth image (h, w) shows of the target, small holes closed."""
    return closed(depth > 0, OUTLINE_REACH_PX)


def is_porous(depth: Image, within: Mask) -> bool:
    """Whether most of the pixels within the outline return nothing."""
    return bool(np.count_nonzero(depth > 0) < (1 - PORES) * np.count_nonzero(within))


@njit(cache=True, nogil=True, error_model='numpy')
def filled(depth: Image, max_jump: float) -> Image:
    """Depth (h, w), metres, with the pores filled: the mean inverse depth of what is measured around each.

    Neighbours more than ``max_jump``, metres, behind the nearest are left out; a pore with too few stays.
    """
    h, w = depth.shape
    out = depth.copy()
    for v in range(h):
        for u in range(w):
            if depth[v, u] > 0:
                continue
            rows = range(max(0, v - FILL_REACH_PX), min(h, v + FILL_REACH_PX + 1))
            columns = range(max(0, u - FILL_REACH_PX), min(w, u + FILL_REACH_PX + 1))
            nearest = np.inf
            for b in rows:
                for a in columns:
                    if 0 < depth[b, a] < nearest:
                        nearest = depth[b, a]
            count, total = 0, 0.0
            for b in rows:
                for a in columns:
                    if 0 < depth[b, a] < nearest + max_jump:
                        count += 1
                        total += 1 / depth[b, a]
            if count >= LEAST_NEIGHBOURS:
                out[v, u] = count / total
    return out
