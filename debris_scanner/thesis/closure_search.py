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

"""Greedy and frugal search for closures (Trowbridge 2014, sections 2.10.2 and 4.4, eq. 2.83 and 2.84).

How far back a frame lies is measured by the rotation travelled since, half a turn being half a period.
Arrays are those of :mod:`debris_scanner.mapping.closure_search`.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.mapping.closure_search import Candidate, Stamps


@dataclass(frozen=True)
class SearchThresholds:
    """When an earlier frame counts as a closure."""

    min_probability: float = 0.8  # joint
    min_turn: float = float(np.pi)  # rad, rotation between the frames: half a period
    preceding: int = 3  # directly preceding key frames that greedy search may link as well


def greedy(
    stamps: Stamps,
    probabilities: Array,
    paths: Array,
    path: float,
    settings: SearchThresholds | None = None,
) -> list[Candidate]:
    """Every likely closure, in order of time, Trowbridge 2014, eq. 2.83 and section 4.4.

    Accepted are all frames of sufficient probability at least half a turn back, and among the few
    directly preceding frames those of sufficient probability. What lies between them looks alike
    merely because little has turned, so section 4.4 leaves it out, while eq. 2.83 alone would not.

    Args:
        stamps: (n,) of the earlier key frames.
        probabilities: (n,) of each.
        paths: (n,) rotation travelled up to each, radians.
        path: rotation travelled up to the newest frame, radians.
        settings: thresholds.
    """
    settings = settings or SearchThresholds()
    allowed = path - paths >= settings.min_turn
    allowed[max(len(stamps) - settings.preceding, 0) :] = True
    chosen = np.flatnonzero(allowed & (probabilities >= settings.min_probability))
    return [_candidate(int(k), stamps, probabilities) for k in chosen]


def frugal(
    stamps: Stamps,
    probabilities: Array,
    paths: Array,
    path: float,
    settings: SearchThresholds | None = None,
) -> Candidate | None:
    """The single best closure at least half a turn back, if any; arguments as :func:`greedy`.

    Trowbridge 2014, eq. 2.84. The thesis then keeps only the best one of the whole session: the
    maximum of these results by probability. Of equals the earliest is returned.
    """
    settings = settings or SearchThresholds()
    allowed = (path - paths >= settings.min_turn) & (probabilities >= settings.min_probability)
    if not allowed.any():
        return None
    best = np.flatnonzero(allowed)[np.argmax(probabilities[allowed])]
    return _candidate(int(best), stamps, probabilities)


def _candidate(k: int, stamps: Stamps, probabilities: Array) -> Candidate:
    return Candidate(k, int(stamps[k]), float(probabilities[k]))
