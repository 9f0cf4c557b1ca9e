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

"""Relaxation of key frames: over the graph's cycles, then over all pairs that look from similar directions.

On the way the sensor is calibrated: what it does to its images is measured from the relaxed views, and taken
off if faces that are seen again agree better without it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    inverse,
    project_so3,
    rotation_angle,
    transform,
)
from debris_scanner.core.parameters import parameter
from debris_scanner.mapping.frame_graph import FrameGraph
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import GATES, Edge, Gates, Relaxed, relax
from debris_scanner.mapping.self_calibration import depth_offset
from debris_scanner.registration.likelihood import shared_evidence
from debris_scanner.registration.projective import MIN_OVERLAP, linearise_pairs
from debris_scanner.registration.view_table import ViewTable
from debris_scanner.sensing.views import View, angles_between

ENOUGH = 0.05  # nats a view, of poses that are relaxed once more afterwards
PAIR_GATES: Gates = (6.7, 4.0)  # px, relaxation over all pairs


@dataclass(frozen=True)
class PoseGraphSettings:
    """Which pairs of key frames become edges, and the bound on iterations."""

    pair_angle_deg: float = parameter(
        28.0, 'key frames seen from closer than this are paired', 'deg', 1.0, 90.0
    )
    pairs: int = parameter(8, 'most pairs a key frame starts', '', 1, 100)
    iterations: int = parameter(12, 'most relaxation iterations', '', 1, 1000)


@dataclass
class Optimised:
    """Relaxed key frames: poses, edges, and how well each edge fits."""

    poses: dict[int, Array]  # T_target_sensor by stamp
    stamps: list[int]
    edges: list[Edge]  # between positions in ``stamps``
    relaxed: Relaxed
    piece: dict[int, int] = field(default_factory=dict)  # by stamp, if pieces were turned apart from others

    @property
    def torn(self) -> set[int]:
        """Stamps of the key frames that were turned apart from the one before."""
        return {b for a, b in pairwise(self.stamps) if self.piece.get(a, 0) != self.piece.get(b, 0)}

    @property
    def rejected_pairs(self) -> set[tuple[int, int]]:
        """Stamps, earlier and later, of the pairs that were switched off."""
        return {
            (self.stamps[e.j], self.stamps[e.i])
            for e, w in zip(self.edges, self.relaxed.weights, strict=True)
            if e.is_closure and w < 0.5
        }

    @property
    def rejected_closures(self) -> set[int]:
        """Stamps of the key frames whose closures were switched off."""
        return {stamp for pair in self.rejected_pairs for stamp in pair}


class Optimiser:
    """Relaxes key frames; their poses stay as they are, and what is found is returned.

    Args:
        keyframes: with their views, which are freed from the sensor's offset as it is found.
        settings: pairs and iterations.
        information_scale: information of a point with noise of the resolution, as in the motion filter.
    """

    def __init__(self, keyframes: KeyFrameSet, settings: PoseGraphSettings, information_scale: float) -> None:
        self.keyframes, self.settings = keyframes, settings
        self._information_scale = information_scale

    def relaxed(
        self,
        poses: list[Array],
        active: list[int],
        in_place: bool,
        torn: Collection[int] = (),
        views: Sequence[View] | None = None,
    ) -> Optimised:
        """Relax key frames over all pairs that look from similar directions.

        Args:
            poses: T_target_sensor (4, 4) to begin from.
            active: key frames, by index.
            in_place: hold the mean pose of all, else that of the first.
            torn: key frames, by index, to which no link leads.
            views: to take in place of the key frames' own, with fewer points.
        """
        seen = views or [self.keyframes.views[k] for k in active]
        edges = self._pairs(seen, poses, active, torn)
        return self._relaxed_over(edges, seen, poses, active, in_place, PAIR_GATES)

    def calibrated(
        self, optimised: Optimised, active: list[int], in_place: bool, calibrations: int
    ) -> Optimised:
        """Relaxed again, freed from what the sensor does to its images, if faces seen again agree better."""
        views, again = self.keyframes.views, self._seen_again(optimised)
        loss: float | None = None
        for _ in range(calibrations if again else 0):
            known = views.offset
            offset = depth_offset(
                [views[k] for k in active],
                optimised.edges,
                optimised.relaxed,
                self.motion_prior(optimised.relaxed.poses, active),
                PAIR_GATES[-1],
                self._information_scale,
                known,
            )
            if offset is known or (offset.is_none and known.is_none):
                break
            loss = self._loss(optimised, again) if loss is None else loss
            views.offset = offset
            # the poses hardly move: the same views overlap, and none is far from its match
            seen = [views[k] for k in active]
            poses, gates = optimised.relaxed.poses, PAIR_GATES[-1:] * 2
            freed = self._relaxed_over(optimised.edges, seen, poses, active, in_place, gates, ENOUGH)
            found = self._loss(freed, again)
            if found >= loss:
                views.offset = known  # whatever is alike from all sides is none of the sensor's
                break
            optimised, loss = freed, found
        return optimised

    def closed(self, graph: FrameGraph, members: list[int], active: list[int]) -> list[Array]:
        """Poses of all active key frames after relaxing the members over the graph's own edges."""
        position = {k: n for n, k in enumerate(members)}
        index = self.keyframes.index
        edges = [
            Edge(position[index[e.later_ns]], position[index[e.earlier_ns]], e.probability is not None)
            for e in graph.edges()
            if index[e.later_ns] in position and index[e.earlier_ns] in position
        ]
        before = [k.T_target_sensor for k in self.keyframes.frames]
        relaxed = relax(
            [self.keyframes.views[k] for k in members],
            [before[k] for k in members],
            edges,
            self.settings.iterations,
            least_gain=ENOUGH * self._nat(members),
        )
        poses = []
        for k in active:
            nearest = min(members, key=lambda m: abs(m - k))
            poses.append(compose(relaxed.poses[position[nearest]], inverse(before[nearest]), before[k]))
        return poses

    def motion_prior(self, poses: Sequence[Array], members: Sequence[int]) -> MotionPrior:
        """The motion through key frames, by their positions, at T_target_sensor (4, 4) each."""
        views, frames = self.keyframes.views, [self.keyframes.frames[k] for k in members]
        linked = [f.linked and k - 1 == j for f, (j, k) in zip(frames[1:], pairwise(members), strict=True)]
        return MotionPrior(
            [f.stamp_ns for f in frames],
            linked,
            poses,
            np.mean([apply(T, views.centroids[k]) for T, k in zip(poses, members, strict=True)], axis=0),
            float(np.median([views.extents[k] for k in members])),
            self._nat(members),
        )

    def _nat(self, members: Sequence[int]) -> float:
        """A nat in the springs' cost, m²: the noise of the points is correlated."""
        resolution = float(np.median([self.keyframes.views[k].resolution for k in members]))
        return resolution**2 / self._information_scale

    def _relaxed_over(
        self,
        edges: list[Edge],
        seen: Sequence[View],
        poses: list[Array],
        active: list[int],
        in_place: bool,
        gates: Gates,
        least_gain: float = 0.0,
    ) -> Optimised:
        prior = self.motion_prior(poses, active)
        least_gain *= self._nat(active)
        relaxed = relax(seen, poses, edges, self.settings.iterations, gates, prior, least_gain)
        relaxed.poses = self._held(relaxed.poses, active, len(active) if in_place else 1)
        stamps = [self.keyframes.frames[k].stamp_ns for k in active]
        return Optimised(dict(zip(stamps, relaxed.poses, strict=True)), stamps, edges, relaxed)

    def _pairs(
        self, views: Sequence[View], poses: list[Array], active: list[int], torn: Collection[int]
    ) -> list[Edge]:
        """Edges between active key frames seen from similar directions that overlap, and odometry edges."""
        s = self.settings
        frames = self.keyframes.frames
        linked = [frames[k].linked and not frames[k].slipped and k not in torn for k in active]
        angles = angles_between(views, poses)
        near: set[tuple[int, int]] = set()
        for k in range(len(poses)):
            for m in np.argsort(angles[k], kind='stable')[: s.pairs + 1]:
                if m != k and angles[k, m] < np.radians(s.pair_angle_deg):
                    near.add((max(k, int(m)), min(k, int(m))))
        pairs = [(i, j) for i, j in sorted(near) if not (i == j + 1 and linked[i])]
        found = linearise_pairs(ViewTable(views), poses, pairs, GATES[0], pictures=False)
        edges = [
            Edge(i, j, is_closure=True)
            for (i, j), pair in zip(pairs, found, strict=True)
            if pair.stats.overlap > MIN_OVERLAP
        ]
        return [Edge(k, k - 1, is_closure=False) for k in range(1, len(poses)) if linked[k]] + edges

    def _held(self, poses: list[Array], active: list[int], count: int) -> list[Array]:
        """The poses moved as one body so that the first ``count`` stay in place on average."""
        M, was, now = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        for k, T in zip(active[:count], poses, strict=False):
            before, seen = self.keyframes.frames[k].T_target_sensor, self.keyframes.views.centroids[k]
            M += before[:3, :3] @ T[:3, :3].T
            was, now = was + apply(before, seen) / count, now + apply(T, seen) / count
        R = project_so3(M)
        T_held_relaxed = transform(R, was - R @ now)
        return [compose(T_held_relaxed, T) for T in poses]

    def _seen_again(self, optimised: Optimised) -> list[Edge]:
        """The pairs that show a face again, at least half a turn later."""
        turns = [rotation_angle(a[:3, :3].T @ b[:3, :3]) for a, b in pairwise(optimised.relaxed.poses)]
        path = np.concatenate([[0.0], np.cumsum(turns)])
        return [e for e in optimised.edges if abs(path[e.i] - path[e.j]) > np.pi]

    def _loss(self, optimised: Optimised, pairs: Sequence[Edge]) -> float:
        """How badly views of pairs explain each other, nats a point."""
        views = [self.keyframes.views[self.keyframes.index[stamp]] for stamp in optimised.stamps]
        poses = optimised.relaxed.poses
        found = [shared_evidence(views[e.i], poses[e.i], views[e.j], poses[e.j]) for e in pairs]
        nats, points = np.sum(found, axis=0) if found else (np.inf, 1.0)
        return float(nats / max(points, 1.0))
