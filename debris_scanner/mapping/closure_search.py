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

"""Closure search: which earlier key frames may show the same face as the newest one.

The probability of a closure joins the similarity of two views with that of their attitudes (Trowbridge 2014,
sections 2.10.5 and 2.10.6). All candidates are ranked; a detector then verifies each by geometry. How far
back a frame lies is measured by the rotation travelled since. Unlike elapsed time, that also holds for a spin
that slows down, and needs no known period.

Arrays run over the earlier key frames in order of time: stamps (n,) int64 nanoseconds, probabilities (n,) of
a closure between the newest frame and each, paths (n,) of rotation travelled, radians.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import parameter

Stamps = NDArray[np.int64]


def relative_angle(R: Array, rotations: Array) -> Array:
    """Angle (n,), 0..pi, between a rotation matrix (3, 3) and many (n, 3, 3).

    The wrapped principal angle of Trowbridge 2014, eq. 2.95-2.100, without quaternions and their two signs.
    The same whether the rotations map sensor to target or back.
    """
    # |R_u - R_v| = sqrt(8) sin(angle / 2) and trace(R_u^T R_v) = 4 cos(angle / 2)^2 - 1; the
    # sine keeps all digits of small angles, where arccos of the trace alone loses half of them.
    sine = np.sqrt(((rotations - R) ** 2).sum(axis=(-2, -1)) / 8.0)
    cosine = np.sqrt(np.maximum((rotations * R).sum(axis=(-2, -1)) + 1.0, 0.0)) / 2.0
    return np.asarray(2.0 * np.arctan2(sine, cosine))


def attitude_probability(R: Array, rotations: Array) -> Array:
    """P_beta (n,) of a rotation (3, 3) against many (n, 3, 3), Trowbridge 2014, eq. 2.101.

    1 for the same attitude, 0 for opposite ones, linear in between. It inherits the drift of the attitude
    estimate. It wrongly separates views that differ by a rotation about the line of sight.
    """
    return 1.0 - relative_angle(R, rotations) / np.pi


def joint_probability(similarity: Array, attitude: Array) -> Array:
    """P_closure = sqrt(P_s P_beta), elementwise, Trowbridge 2014, eq. 2.102."""
    return np.asarray(np.sqrt(similarity * attitude))


@dataclass(frozen=True)
class ClosureSearchSettings:
    """When an earlier frame counts as a closure."""

    min_path: float = parameter(1.5, 'rotation travelled between the key frames of a candidate', 'rad', 0.0)
    neighbours: int = parameter(1, 'key frames beside a better candidate that come last', '', 0)


@dataclass(frozen=True)
class Candidate:
    """An earlier key frame that may close a loop with the newest one."""

    index: int  # into the arrays given
    stamp_ns: int
    probability: float


def candidates(
    stamps: Stamps,
    probabilities: Array,
    paths: Array,
    path: float,
    settings: ClosureSearchSettings | None = None,
    among: NDArray[np.bool_] | None = None,
    most: int | None = None,
) -> list[Candidate]:
    """All frames far enough back, in the order in which to verify them.

    Most probable first, without a threshold: verification decides. Key frames next to a more probable one
    show nearly the same view and would fail or succeed with it, so they come last.

    Args:
        stamps: (n,) of the earlier key frames.
        probabilities: (n,) of each.
        paths: (n,) rotation travelled up to each, radians.
        path: rotation travelled up to the newest frame, radians.
        settings: thresholds.
        among: (n,) which frames to return; the others still count in the ranking. None returns all.
        most: largest number returned; thousands cost milliseconds.
    """
    settings = settings or ClosureSearchSettings()
    n = len(stamps)
    eligible = np.flatnonzero(np.abs(path - paths) >= settings.min_path)
    order = eligible[np.argsort(-probabilities[eligible], kind='stable')]
    rank = np.full(n, n)
    rank[order] = np.arange(len(order))
    if n:
        best_around = scipy.ndimage.minimum_filter1d(rank, 2 * settings.neighbours + 1, mode='nearest')
        peak = rank[order] == best_around[order]
        order = np.concatenate([order[peak], order[~peak]])
    if among is not None:
        order = order[among[order]]
    return _make_candidates(order[:most], stamps, probabilities)


def _make_candidates(indices: NDArray[np.intp], stamps: Stamps, probabilities: Array) -> list[Candidate]:
    rows = zip(indices.tolist(), stamps[indices].tolist(), probabilities[indices].tolist(), strict=True)
    return [Candidate(*row) for row in rows]
