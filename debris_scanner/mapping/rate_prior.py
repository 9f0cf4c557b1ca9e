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

"""What is known of the motion when key frames are relaxed: a free body's rate changes slowly.

Views of a nearly round target tell little of its turn, and edge-on views of a panel little of anything.
The motion bridges them. Between three key frames in a row the mean rates, seen by the sensor, may
differ as far as an angular acceleration allows that is normal and white (Anderson and Barfoot 2015):

    e = w_bc - w_ab,   w_ab = log(R_bᵀ R_a) / (t_b - t_a),   e ~ N(0, (sigma (t_c - t_a) / 2)²)

The acceleration's sigma is measured on the scan itself, so that a hand or a brake is not smoothed away. The
noise of the poses is in it too, less so over longer spans: the least of several spans counts. A Cauchy
weight lets single jumps be, as of a turntable that stops.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, log_so3

SPANS = (1, 2, 4, 6)  # key frames to either side: over more, a tumbling target's acceleration turns
FEWEST = 6  # triples, of which a sigma is measured
MEDIAN_NORM = 1.54  # of a normal vector (3,), in sigmas
LEAST = 1e-3  # rad/s²: less is not told from none
JUMP = 3.0  # sigmas, where the Cauchy weight falls to a half
LARGEST_TURN = 1.0  # rad, between two key frames: beyond, their mean rate says little


class RatePrior:
    """Normal equations of the rates' changes along a chain of key frames.

    Args:
        stamps_ns: (n,) of the key frames.
        linked: (n - 1,) whether each is tracked on to the next.
        poses: T_target_view (4, 4) of each, on which the acceleration is measured.
        weight: information of 1 rad⁻² in the unit of the normal equations that this is added to.
    """

    def __init__(
        self, stamps_ns: Sequence[int], linked: Sequence[bool], poses: Sequence[Array], weight: float
    ) -> None:
        self._t = (np.asarray(stamps_ns, np.int64) - stamps_ns[0]) * 1e-9
        self._weight = weight
        turns = _turns(poses)
        self._linked = np.asarray(linked, bool) & (np.linalg.norm(turns, axis=1) < LARGEST_TURN)
        self._linked &= np.diff(self._t) > 0
        self.sigma = self._measure(turns)  # rad/s²; infinite where it is not known

    def add(self, poses: Sequence[Array], blocks: dict[tuple[int, int], Array], gradient: Array) -> None:
        """Add to the blocks (6, 6) by row and column and to the gradient (n, 6), for left twists."""
        middles = self._middles(1)
        if not np.isfinite(self.sigma) or not len(middles):
            return
        dt, turns = np.diff(self._t), _turns(poses)
        for b in middles:
            a, c = b - 1, b + 1
            e = turns[b] / dt[b] - turns[a] / dt[a]
            sigma = self.sigma * 0.5 * (dt[a] + dt[b])
            weight = self._weight / (sigma**2 * (1 + (e @ e) / (JUMP * sigma) ** 2))
            R_b, R_c = poses[b][:3, :3].T / dt[a], poses[c][:3, :3].T / dt[b]
            J = {a: -R_b, b: R_b + R_c, c: -R_c}
            for i, J_i in J.items():
                gradient[i, :3] += weight * J_i.T @ e
                for j, J_j in J.items():
                    block = blocks.setdefault((i, j), np.zeros((6, 6)))
                    block[:3, :3] += weight * J_i.T @ J_j

    def _measure(self, turns: Array) -> float:
        """Standard deviation, rad/s², of each component of the angular acceleration."""
        travelled = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
        found = [np.inf]
        for span in SPANS:
            b = self._middles(span)
            if len(b) < FEWEST:
                break
            before, after = self._t[b] - self._t[b - span], self._t[b + span] - self._t[b]
            change = (travelled[b + span] - travelled[b]) / after[:, None]
            change -= (travelled[b] - travelled[b - span]) / before[:, None]
            acceleration = np.linalg.norm(change, axis=1) / (0.5 * (before + after))
            found.append(float(np.median(acceleration)) / MEDIAN_NORM)
        return max(min(found), LEAST)

    def _middles(self, span: int) -> NDArray[np.intp]:
        """Key frames that are linked with so many to either side."""
        n = len(self._t)
        breaks = np.concatenate([[0], np.cumsum(~self._linked)])
        b = np.arange(span, n - span)
        return b[breaks[b + span] == breaks[b - span]]


def _turns(poses: Sequence[Array]) -> Array:
    """Rotation vectors (n - 1, 3), rad, of the target from each pose to the next, as the sensor sees them."""
    R = [T[:3, :3] for T in poses]
    return np.array([log_so3(later.T @ earlier) for earlier, later in pairwise(R)])
