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

"""Section 5.3 redone: how the similarities are distributed, their entropy, and what they are worth (T29).

The thesis pools the probabilities of the last half of its shuttle data sets and argues from their spread.
Truth is known here, so that the ROC can say which of them tells the same face from others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.report.discrimination import area_under, entropy_bits, roc
from debris_scanner.research.reproduce.likeness import Likeness
from debris_scanner.research.thesis.settings import SIMILARITIES

ATTITUDE = 'attitude'


@dataclass(frozen=True)
class Pool:
    """Pairs of frames of several runs, each with all its probabilities."""

    similarity: dict[str, Array]  # (m,) by measure
    joint: dict[str, Array]  # (m,) by the similarity in it
    attitude: Array  # (m,)
    same: NDArray[np.bool_]  # (m,) truly the same face

    @staticmethod
    def of(runs: Sequence[Likeness], late: bool) -> 'Pool':
        """Pairs of the last halves of the runs, or else all pairs with half a turn in between.

        Args:
            runs: at least one.
            late: choose as section 5.3 does; entropy needs no truth, and asks of all pairs.
        """
        chosen = [r.late if late else r.apart for r in runs]
        both = list(zip(runs, chosen, strict=True))
        return Pool(
            {k: np.concatenate([r.similarity[k][c] for r, c in both]) for k in SIMILARITIES},
            {k: np.concatenate([r.joint(k)[c] for r, c in both]) for k in SIMILARITIES},
            np.concatenate([r.attitude[c] for r, c in both]),
            np.concatenate([r.same[c] for r, c in both]),
        )

    def curve(self, values: Array) -> tuple[Array, Array, float] | None:
        """False and true positive rates and the area; None where all pairs are of one kind."""
        if self.same.all() or not self.same.any():
            return None
        false, true = roc(values, self.same)
        return false, true, area_under(false, true)


def summary(late: Pool, apart: Pool) -> dict[str, dict[str, float | int | None]]:
    """Mean, spread, entropy and area under the ROC of each measure, alone and joined with the attitude."""
    lines: dict[str, dict[str, float | int | None]] = {}
    for kind in SIMILARITIES:
        lines[kind] = _line(late.similarity[kind], apart, apart.similarity[kind])
        lines[f'joint_{kind}'] = _line(late.joint[kind], apart, apart.joint[kind])
    lines[ATTITUDE] = _line(late.attitude, apart, apart.attitude)
    return lines


def _line(late: Array, apart: Pool, values: Array) -> dict[str, float | int | None]:
    curve = apart.curve(values)
    return {
        'pairs': len(late),
        'mean': round(float(late.mean()), 4) if len(late) else None,
        'sigma': round(float(late.std()), 4) if len(late) else None,
        'entropy_bits': round(entropy_bits(late), 3),
        'roc_area': None if curve is None else round(curve[2], 4),
        'roc_pairs': len(values),
    }
