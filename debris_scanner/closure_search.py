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

"""Which earlier key frames may show the same face as the newest one.

Everything is ranked, for a detector that verifies each hypothesis by geometry. How far back a frame lies is
measured by the rotation travelled since: unlike elapsed time that also holds for a spin that slows down, and
needs no period beforehand.

Arrays run over the earlier key frames in order of time: stamps (n,) int64 nanoseconds, probabilities
(n,) of the newest frame closing a loop with each, paths (n,) of rotation travelled, radians.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from debris_scanner.geometry import Array
from debris_scanner.parameters import parameter

Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class ClosureSearchSettings:
    """When an earlier frame counts as a closure."""

    min_path: float = parameter(1.5, 'rotation travelled between the key frames of a candidate', 'rad', 0.0)
    neighbours: int = parameter(
        1, 'key frames to either side of a better candidate that are tried only after all others', '', 0
    )


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
    """All frames far enough back, in the order in which to try them.

    Most probable first, without a threshold: verification decides. Key frames next to a more probable
    one show nearly the same view and would fail or succeed with it, so they come after all others.

    Args:
        stamps: (n,) of the earlier key frames.
        probabilities: (n,) of each.
        paths: (n,) rotation travelled up to each, radians.
        path: rotation travelled up to the newest frame, radians.
        settings: thresholds.
        among: (n,) which frames to name; the others still count in the order. None names all.
        most: frames named at most; thousands cost milliseconds.
    """
    settings = settings or ClosureSearchSettings()
    n = len(stamps)
    eligible = np.flatnonzero(np.abs(path - paths) >= settings.min_path)
    order = eligible[np.argsort(-probabilities[eligible], kind='stable')]
    rank = np.full(n, n)
    rank[order] = np.arange(len(order))
    if n:
        best_around = minimum_filter1d(rank, 2 * settings.neighbours + 1, mode='nearest')
        peak = rank[order] == best_around[order]
        order = np.concatenate([order[peak], order[~peak]])
    if among is not None:
        order = order[among[order]]
    return _named(order[:most], stamps, probabilities)


def _named(indices: NDArray[np.intp], stamps: Stamps, probabilities: Array) -> list[Candidate]:
    rows = zip(indices.tolist(), stamps[indices].tolist(), probabilities[indices].tolist(), strict=True)
    return [Candidate(*row) for row in rows]
