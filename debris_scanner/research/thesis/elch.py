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

"""Sharing out a loop's error along the frames, the cheap alternative to relaxing it (ELCH).

Trowbridge 2014, section 2.2.6, eq. 2.26, after Nuechter: the correction that closes the loop is given to
each frame in proportion to the way travelled. Without better knowledge every step counts the same, which
is what PCL's ELCH does on a plain loop.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from debris_scanner.core.geometry import Array, transform


def even_shares(frames: int) -> Array:
    """Shares (n,) 0..1 of a loop's frames from the first to the last, every step alike.

    Raises:
        ValueError: for less than two frames.
    """
    if frames < 2:
        raise ValueError(f'a loop needs two frames, not {frames}')
    return np.arange(frames) / (frames - 1)


def travelled_shares(angles: Array) -> Array:
    """Shares (n,) 0..1 by the rotation between consecutive frames (n - 1,), radians; eq. 2.26.

    A target at rest throughout has them even.
    """
    path = np.concatenate([[0.0], np.cumsum(np.abs(angles))])
    return path / path[-1] if path[-1] > 0 else even_shares(len(path))


def distribute(loop: Array, shares: Array) -> list[Array]:
    """Corrections (4, 4), one a frame, applied on the left of its pose: that share of the loop's correction.

    Args:
        loop: transform (4, 4) that moves the last frame to where the closure wants it.
        shares: (n,) 0..1 of each frame.

    Rotation about a fixed axis and translation along a straight line.
    """
    turn = Rotation.from_matrix(loop[:3, :3]).as_rotvec()
    return [transform(Rotation.from_rotvec(s * turn).as_matrix(), s * loop[:3, 3]) for s in shares]


def close_loop(poses: Sequence[Array], loop: Array, shares: Array | None = None) -> list[Array]:
    """Poses (4, 4) of a loop's frames after :func:`distribute`; shares default to even ones."""
    corrections = distribute(loop, even_shares(len(poses)) if shares is None else shares)
    return [c @ T for c, T in zip(corrections, poses, strict=True)]
