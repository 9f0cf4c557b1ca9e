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

"""The axes of a cloud: how its coordinates lie in the optical frame (x right, y down, z forward).

Drivers of lidars, ZED cameras and Gazebo send clouds in body frames (REP-103: x forward, y left, z up). A
camera's organised cloud shows its axes by itself: in one of them alone it is the image of a pinhole camera.
"""

import re

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import finite, fit_pinhole
from debris_scanner.core.geometry import Array

OPTICAL = np.eye(3)
BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # R_optical_body
AXES_HELP = "the cloud's axis that points right, down and forward, as =-y,-z,x or =x,-y,0.7-z"
_OFF_AXIS = 0.5  # cosine: an optical cloud lies within 60 deg of +z
_NAMES = ('+x', '+y', '+z', '-x', '-y', '-z')


def parse_axes(text: str) -> Array:
    """T_optical_cloud (4, 4) of three axes by commas, each with an offset in metres if it has one.

    Raises:
        ValueError: not three different axes, or a mirror image.
    """
    T = np.eye(4)
    parts = text.replace(' ', '').split(',')
    if len(parts) == 3:
        T[:3, :3] = 0
        for row, part in enumerate(parts):
            found = re.fullmatch(r'([+-]?)([xyz])([+-][\d.]+)?', part) or re.fullmatch(
                r'(?P<offset>[\d.]+)(?P<sign>[+-])(?P<axis>[xyz])', part
            )
            if found is None:
                break
            named = found.groupdict()
            sign, axis = named.get('sign', found[1]), named.get('axis', found[2])
            try:
                T[row, 3] = float(named.get('offset', found[3]) or 0)
            except ValueError:
                break
            T[row, 'xyz'.index(axis)] = -1 if sign == '-' else 1
        else:
            if np.isclose(np.linalg.det(T[:3, :3]), 1):
                return T
            raise ValueError(f'{text!r} are no axes of a right-handed frame: {AXES_HELP}')
    raise ValueError(f'{text!r} are no axes: {AXES_HELP}')


def camera_axes(points: NDArray[np.float32]) -> Array | None:
    """R_optical_cloud (3, 3) of an organised cloud (h, w, 3), metres, that a camera explains; or None."""
    for R in (OPTICAL, BODY):
        if fit_pinhole(rotated(points, R)) is not None:
            return R
    return None


def lies_along(points: NDArray[np.float32]) -> str:
    """The axis that a cloud (..., 3) lies along, such as '+x'; '' if that is an optical frame's +z."""
    p = points.reshape(-1, 3)
    p = p[finite(p)].astype(np.float64)
    distance = np.linalg.norm(p, axis=1)
    p = p[(distance > 0) & np.isfinite(distance)]
    if not len(p):
        return ''
    mean = (p / np.linalg.norm(p, axis=1)[:, None]).mean(axis=0)
    if mean[2] >= _OFF_AXIS * np.linalg.norm(mean):
        return ''
    return _NAMES[int(np.argmax([*mean, *-mean]))]


def rotated(points: NDArray[np.float32], R: Array) -> NDArray[np.float32]:
    """Points (..., 3) turned by R (3, 3); those with NaN or Inf become NaN."""
    if R is OPTICAL:
        return points
    with np.errstate(all='ignore'):
        out: NDArray[np.float32] = points @ R.T.astype(np.float32)
    return out
