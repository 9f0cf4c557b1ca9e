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

from collections.abc import Collection, Sequence
from copy import copy
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, exp_se3, transform
from debris_scanner.registration.likelihood import BeamModel, PairLikelihood, pair_likelihoods
from debris_scanner.registration.view_table import ViewTable
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

    _coarse: Self | None

    def __init__(self, views: Sequence[View], poses: Sequence[Array], sensor: SensorModel) -> None:
        self._all = ViewTable([v.thinned(max(1, round(len(v.points) / POINTS))) for v in views])
        self._few = ViewTable([v.thinned(COARSE) for v in self.views])
        self.poses = list(poses)
        centroids = [apply(T, v.centroid) for v, T in zip(views, poses, strict=True)]
        self.centre = np.mean(centroids, axis=0)
        self.beam = BeamModel.of(sensor, views)
        self._pair_up()

    @property
    def views(self) -> list[View]:
        """With the points that are compared."""
        return self._all.views

    def posed(self, poses: Sequence[Array]) -> Self:
        """The same views at other poses, paired anew."""
        other = copy(self)
        other.poses = list(poses)
        other._pair_up()
        return other

    def coarse(self) -> Self:
        """The same views with a quarter of their points, for many questions that need no more."""
        if self._all is self._few:
            return self
        if self._coarse is None:
            self._coarse = other = copy(self)
            other._all, other._as_posed = self._few, {}
        return self._coarse

    def without(self, left_out: Collection[int]) -> Self:
        """The views but some, by index, paired anew; what is known of a pair is kept."""
        kept = [k for k in range(len(self.views)) if k not in left_out]
        index, known, other = {k: n for n, k in enumerate(kept)}, self._as_posed, copy(self)
        other._all, other._few = self._all.some(kept), self._few.some(kept)
        other.poses = [self.poses[k] for k in kept]
        other._pair_up()
        other._as_posed = {
            (index[i], index[j]): pair for (i, j), pair in known.items() if i in index and j in index
        }
        return other

    def pairs_at(
        self, pairs: Sequence[tuple[int, int]], widen: float = 1.0, poses: Sequence[Array] | None = None
    ) -> list[PairLikelihood]:
        """Likelihood of pairs, at their poses or at others; with few points where the noise is widened."""
        if poses is not None or widen != 1.0:
            return self._compared(pairs, widen, poses or self.poses)
        unknown = [pair for pair in dict.fromkeys(pairs) if pair not in self._as_posed]
        self._as_posed |= zip(unknown, self._compared(unknown, widen, self.poses), strict=True)
        return [self._as_posed[pair] for pair in pairs]

    def pair(self, i: int, j: int, poses: Sequence[Array] | None = None) -> PairLikelihood:
        """:meth:`pairs_at` of one."""
        return self.pairs_at([(i, j)], 1.0, poses)[0]

    def _compared(
        self, pairs: Sequence[tuple[int, int]], widen: float, poses: Sequence[Array]
    ) -> list[PairLikelihood]:
        if not pairs:
            return []
        table = self._all if widen == 1.0 else self._few
        return pair_likelihoods(table, poses, pairs, self.beam, self.centre, widen)

    def moved(self, inside: NDArray[np.bool_], twist: Array, poses: Sequence[Array]) -> list[Array]:
        """The poses, those inside moved by a twist (6,) about the centre."""
        return [self.moved_pose(twist, T) if k else T for k, T in zip(inside, poses, strict=True)]

    def moved_pose(self, twist: Array, T: Array) -> Array:
        """A pose moved by a twist (6,) about the centre."""
        about, back = transform(np.eye(3), self.centre), transform(np.eye(3), -self.centre)
        return compose(about, exp_se3(twist), back, T)

    def _pair_up(self) -> None:
        self._as_posed: dict[tuple[int, int], PairLikelihood] = {}
        self._coarse = None
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
