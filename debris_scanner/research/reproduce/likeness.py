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

"""How alike the kept frames of a run are, by every measure, beside whether they truly show the same face."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.evaluation.trajectory_errors import TRUE_CLOSURE_RAD
from debris_scanner.mapping.closure_search import attitude_probability, joint_probability
from debris_scanner.mapping.descriptors import DescriptorSettings, efpfh
from debris_scanner.research.thesis.loop_closures import similarities
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.settings import SIMILARITIES

MEASURE_NAMES = {
    'float': 'float $P_{s,f}$',
    'binary_median': 'binary $P_{s,b}$, median',
    'binary_mean': 'binary, mean',
    'binary_per_bin': 'binary, per bin',
    'normalised': 'normalised binary',
}
_HALF_TURN = np.pi  # pairs with less rotation in between are alike merely because little has turned


@dataclass(frozen=True)
class Likeness:
    """Of one run's n kept frames; matrices have NaN where the column is not earlier than the row."""

    stamps: NDArray[np.int64]  # (n,)
    histograms: Array  # (n, 180)
    similarity: dict[str, Array]  # (n, n) by measure
    attitude: Array  # (n, n), P_beta of the estimator
    same: NDArray[np.bool_]  # (n, n), true attitudes within 10 degrees
    path: Array  # (n,) rotation travelled, radians, as estimated

    @staticmethod
    def of(motion: Odometry, truth: Mapping[int, Array], descriptor: DescriptorSettings) -> 'Likeness':
        """Descriptors, similarities and truth of the frames that the odometry kept."""
        clouds = [motion.clouds[k] for k in motion.kept]
        histograms = np.array([efpfh(c.points, c.normals, descriptor) for c in clouds], np.float64)
        R = np.array([motion.attitudes[k] for k in motion.kept])
        attitude = np.full((len(R), len(R)), np.nan)
        for k in range(1, len(R)):
            attitude[k, :k] = attitude_probability(R[k], R[:k])
        true = np.array([truth[c.stamp_ns][:3, :3] for c in clouds])
        cosine = (np.einsum('aij,bij->ab', true, true) - 1) / 2
        return Likeness(
            np.array([c.stamp_ns for c in clouds], np.int64),
            histograms,
            {kind: similarities(histograms, kind) for kind in SIMILARITIES},
            attitude,
            np.arccos(np.clip(cosine, -1, 1)) <= TRUE_CLOSURE_RAD,
            motion.path[motion.kept],
        )

    def joint(self, kind: str) -> Array:
        """P_closure (n, n) with one of the similarities."""
        return joint_probability(self.similarity[kind], self.attitude)

    @property
    def late(self) -> NDArray[np.bool_]:
        """Pairs (n, n) whose newer frame is in the last half of the run, as section 5.3 pools them."""
        n = len(self.stamps)
        newer = np.arange(n)[:, None] >= n // 2
        return np.asarray(newer & np.isfinite(self.attitude))

    @property
    def apart(self) -> NDArray[np.bool_]:
        """Pairs (n, n) with at least half a turn in between: those a closure may join."""
        return np.asarray((self.path[:, None] - self.path[None] >= _HALF_TURN) & np.isfinite(self.attitude))

    def encode(self) -> bytes:
        """As an npz file."""
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            stamps=self.stamps,
            histograms=self.histograms,
            attitude=self.attitude,
            same=self.same,
            path=self.path,
        )
        return buffer.getvalue()

    @staticmethod
    def read(path: Path) -> 'Likeness':
        """From an npz file of :meth:`encode`; the similarities are computed anew."""
        with np.load(path, allow_pickle=False) as file:
            histograms = np.asarray(file['histograms'], np.float64)
            return Likeness(
                np.asarray(file['stamps'], np.int64),
                histograms,
                {kind: similarities(histograms, kind) for kind in SIMILARITIES},
                np.asarray(file['attitude'], np.float64),
                np.asarray(file['same'], bool),
                np.asarray(file['path'], np.float64),
            )
