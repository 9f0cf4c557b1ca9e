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

"""Pairs of posed key frames that look from similar directions, compared by their likelihood."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, exp_se3, transform
from debris_scanner.registration.likelihood import BeamModel, PairLikelihood, pair_likelihood
from debris_scanner.sensing.sensor_model import SensorModel
from debris_scanner.sensing.views import View, angles_between

POINTS = 600  # of a view, compared with another
COARSE = 4  # of these points one is used while poses are still far from where they settle
# For each key frame and ring of view angles: those nearest and farthest in time.
RINGS = np.radians([0.0, 10.0, 20.0, 35.0, 60.0])


class PosedViews:
    """Key frames with poses, and the pairs of them that say something.

    Args:
        views: in order of time.
        poses: T_target_view (4, 4).
        sensor: noise measured on the stream.
    """

    def __init__(self, views: Sequence[View], poses: Sequence[Array], sensor: SensorModel) -> None:
        self.views = [v.thinned(max(1, round(len(v.points) / POINTS))) for v in views]
        self._coarse = [v.thinned(COARSE) for v in self.views]
        self.poses = list(poses)
        centroids = [apply(T, v.centroid) for v, T in zip(views, poses, strict=True)]
        self.centre = np.mean(centroids, axis=0)
        self.beam = BeamModel.of(sensor, views)
        self._pair_up()

    def posed(self, poses: Sequence[Array]) -> Self:
        """The same views at other poses, paired anew."""
        other = object.__new__(type(self))
        other.views, other._coarse, other.poses = self.views, self._coarse, list(poses)
        other.centre, other.beam = self.centre, self.beam
        other._pair_up()
        return other

    def coarse(self) -> Self:
        """The same views with a quarter of their points, for many questions that need no more."""
        other = object.__new__(type(self))
        other.views = other._coarse = self._coarse
        other.poses, other.pairs, other._as_posed = self.poses, self.pairs, {}
        other.centre, other.beam = self.centre, self.beam
        return other

    def pair(
        self, i: int, j: int, widen: float = 1.0, poses: Sequence[Array] | None = None
    ) -> PairLikelihood:
        """Likelihood of a pair, at its poses or at others; with few points where the noise is widened."""
        if poses is not None or widen != 1.0:
            return self._pair(i, j, widen, poses or self.poses)
        if (i, j) not in self._as_posed:
            self._as_posed[i, j] = self._pair(i, j, widen, self.poses)
        return self._as_posed[i, j]

    def _pair(self, i: int, j: int, widen: float, T: Sequence[Array]) -> PairLikelihood:
        views = self.views if widen == 1.0 else self._coarse
        return pair_likelihood(views[i], T[i], views[j], T[j], self.beam, self.centre, widen)

    def moved(self, inside: NDArray[np.bool_], twist: Array, poses: Sequence[Array]) -> list[Array]:
        """The poses, those inside moved by a twist (6,) about the centre."""
        return [self.moved_pose(twist, T) if k else T for k, T in zip(inside, poses, strict=True)]

    def moved_pose(self, twist: Array, T: Array) -> Array:
        """A pose moved by a twist (6,) about the centre."""
        about, back = transform(np.eye(3), self.centre), transform(np.eye(3), -self.centre)
        return compose(about, exp_se3(twist), back, T)

    def _pair_up(self) -> None:
        self._as_posed: dict[tuple[int, int], PairLikelihood] = {}
        n = len(self.views)
        angles = angles_between(self.views, self.poses) if n > 1 else np.zeros((n, n))
        chosen = {(i - 1, i) for i in range(1, n)}  # wherever they are posed
        every = np.arange(n)
        apart = np.abs(every[:, None] - every)
        for low, high in pairwise(RINGS):
            ring = (angles >= low) & (angles < high) & (apart > 0)
            first = np.flatnonzero(ring.any(axis=1))
            for partner in (np.where(ring, apart, n).argmin(axis=1), np.where(ring, apart, 0).argmax(axis=1)):
                pairs = np.sort(np.column_stack([first, partner[first]]), axis=1)
                chosen.update(map(tuple, pairs.tolist()))
        self.pairs = sorted(chosen)
