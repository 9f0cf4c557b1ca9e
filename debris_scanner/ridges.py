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

"""Ridges of a view, where fitted planes round what is sharp: compiled, for every frame passes here."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.float32]


@njit(cache=True, nogil=True, error_model='numpy')
def depth_with_ridges(depth: Image, depth_fit: Image, normals: Image, reach: int, cosine: float) -> Image:
    """Fitted depth (h, w), metres, but the measured one on ridges; 0 where nothing is fitted.

    A ridge is where the normals so many pixels to either side, above and below or left and right, differ
    by more than the angle of that cosine.
    """
    h, w = depth.shape
    out = depth_fit.copy()
    least = np.float32(cosine)
    for v in range(h):
        for u in range(w):
            if depth_fit[v, u] <= 0:
                continue
            ridge = False
            if reach <= v < h - reach:
                ridge = _dot(normals[v - reach, u], normals[v + reach, u]) < least
            if not ridge and reach <= u < w - reach:
                ridge = _dot(normals[v, u - reach], normals[v, u + reach]) < least
            if ridge:
                out[v, u] = depth[v, u]
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def _dot(a: Image, b: Image) -> np.float32:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
