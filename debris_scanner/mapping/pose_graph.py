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

"""Pose graph of the scan: which key frames belong together, and their poses after relaxation.

A closure makes a cycle. Pruning keeps the key frames on cycles (Trowbridge 2014, section 3.2), and relaxation
distributes the drift among them. Then every pair of key frames that look from similar directions becomes an
edge too, and all key frames are relaxed together.

The relaxed poses also reveal partially occluded key frames that odometry took for unoccluded: what came into
sight behind an occluding edge had never been seen, so nothing was missing. Other views show points beside
such a key frame's silhouette, while none of its own points contradicts them, as they would at a wrong pose.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from debris_scanner.core.frames import KeyFrame
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
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.frame_graph import FrameGraph, FrameGraphSettings
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import SWITCH_CONFLICT_RATIO, Edge, Gates, Relaxed, relax
from debris_scanner.mapping.self_calibration import depth_offset
from debris_scanner.registration.likelihood import shared_evidence
from debris_scanner.registration.projective import MIN_OVERLAP, linearise, linearise_shapes
from debris_scanner.sensing.depth_offset import NO_OFFSET
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View, angles_between

# Partial occlusion: of at most WITNESSES other views within REACH, MIN_WITNESSES must show it.
REACH = np.radians(70.0)
WITNESSES = 12
MIN_WITNESSES = 2
MIN_MISSING_RATIO = 0.15  # share of the witness's visible points beside the view's silhouette
MAX_SILHOUETTE_VIOLATION = 0.06  # of the view's own points in the witness
MAX_CONFLICT_RATIO = 0.035
MAX_RMS = 1.55  # px
MAX_OCCLUDED_SHARE = 0.25  # of the views; beyond, the poses are wrong
GATE = 8.0  # px
MAX_UNSUPPORTED_SHARE = 0.25  # of the key frames, with no neighbour that agrees; beyond, the graph is wrong
ENOUGH = 0.05  # nats a view, of poses that are relaxed once more afterwards
CALIBRATIONS = 3  # of the sensor at the end of a scan: poses and offset are linearised anew
PAIR_GATES: Gates = (6.7, 4.0)  # px, relaxation over all pairs


def partially_occluded_views(views: Sequence[View], poses: Sequence[Array]) -> set[int]:
    """Indices of the views, posed by T_target_view (4, 4), that other views show to be partially occluded."""
    angles = angles_between(views, poses)
    occluded = set()
    for k in range(len(views)):
        near = [int(m) for m in np.argsort(angles[k], kind='stable') if m != k and angles[k, m] < REACH]
        witnesses = 0
        for m in near[:: max(1, len(near) // WITNESSES)]:  # spread: neighbours in time are occluded alike
            witnesses += _shows_occlusion(views[m], poses[m], views[k], poses[k])
            if witnesses == MIN_WITNESSES:
                occluded.add(k)
                break
    return occluded if len(occluded) <= MAX_OCCLUDED_SHARE * len(views) else set()


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


class PoseGraph:
    """Grows with key frames and closures; ``optimise`` relaxes the connected ones.

    Args:
        settings: pairs and iterations.
        normals: of the views that are prepared anew.
        information_scale: information of a point with noise of the resolution, as in the motion filter.
    """

    def __init__(
        self, settings: PoseGraphSettings, normals: NormalSettings, information_scale: float
    ) -> None:
        self.settings = settings
        self._information_scale = information_scale
        self.keyframes = KeyFrameSet(normals)
        self.closures: list[Closure] = []  # accepted ones
        self._proven: set[tuple[int, int]] = set()  # that made a model
        self.graph = FrameGraph(FrameGraphSettings())

    def add_keyframe(self, keyframe: KeyFrame) -> None:
        """Append a key frame, with an odometry edge to the previous one unless it starts a submap."""
        self.keyframes.add(keyframe)
        self.graph.add_frame(keyframe.stamp_ns, linked=self.keyframes.frames[-1].linked)

    def add_closure(self, closure: Closure) -> None:
        """Add an accepted closure; one between two submaps merges them.

        Raises:
            ValueError: one of its key frames is unknown, or it has no pose.
        """
        if closure.T_from_to is None:
            raise ValueError(f'closure {closure.from_stamp_ns} - {closure.to_stamp_ns} was never registered')
        self.keyframes.join(closure.from_stamp_ns, closure.to_stamp_ns, closure.T_from_to)
        self.graph.add_closure(closure.from_stamp_ns, closure.to_stamp_ns, closure.probability)
        self.closures.append(closure)

    def prove_closures(self) -> None:
        """The closures so far have made a model: they are never dropped."""
        self._proven = {(c.from_stamp_ns, c.to_stamp_ns) for c in self.closures}

    def refuse(self, refused: Optimised, modelled: bool) -> None:
        """Take back what a refused optimisation rests on: the closures that it rejected.

        Without a model, if it rejected none the newest one, and what it found of the sensor.

        Args:
            refused: the optimisation.
            modelled: there is a model.
        """
        if not modelled:
            self.keyframes.views.offset = NO_OFFSET
        rejected = refused.rejected_pairs - self._proven
        kept = [c for c in self.closures if (c.from_stamp_ns, c.to_stamp_ns) not in rejected]
        if len(kept) == len(self.closures) and not modelled:
            kept = kept[:-1]
        self.closures = kept
        self._link()

    def part(self, stamps_ns: Collection[int]) -> bool:
        """Take the parts that these key frames joined with out again, and their closures with others.

        Returns:
            Whether any had been joined.
        """
        apart = self.keyframes.part(stamps_ns)
        submap = {f.stamp_ns: f.submap for f in self.keyframes.frames}
        self.closures = [c for c in self.closures if submap[c.from_stamp_ns] == submap[c.to_stamp_ns]]
        self._link()
        return apart

    def use(self, keyframes: KeyFrameSet) -> None:
        """Go on with another set of key frames; it has those of all closures."""
        self.keyframes = keyframes
        self._link()

    def _link(self) -> None:
        """The graph of all key frames and closures."""
        self.graph = FrameGraph(FrameGraphSettings())
        for keyframe in self.keyframes.frames:
            self.graph.add_frame(keyframe.stamp_ns, linked=keyframe.linked)
        for c in self.closures:
            self.graph.add_closure(c.from_stamp_ns, c.to_stamp_ns, c.probability)

    def optimise(self, in_place: bool = False, final: bool = False) -> Optimised | None:
        """Relaxed poses of all active key frames, or None when no cycle of theirs survives pruning.

        Args:
            in_place: hold the mean pose of all key frames, else that of the first alone. Held by one key
                frame, a tracked target would jump by that key frame's error.
            final: calibrate the sensor to the last; else once, and on in the next attempt.
        """
        calibrations = CALIBRATIONS if final else 1
        optimised = self._optimise(in_place, calibrations)
        if optimised is not None and self._update_occlusion(optimised):
            optimised = self._optimise(in_place, calibrations)
        if optimised is not None:
            self.mark_usable(optimised)
        return optimised

    def evened(self, optimised: Optimised, in_place: bool = False) -> Optimised | None:
        """A rival of an optimisation: the target turned evenly throughout; None where it did anyhow."""
        before = optimised.relaxed.poses
        poses = self.motion_prior(before, self._members(optimised)).evened(before)
        return None if poses is None else self.relaxed_from(optimised, poses, in_place)

    def jumps(self, optimised: Optimised) -> list[int]:
        """Key frames of an optimisation, by index, at which the rate of the motion jumps."""
        poses = optimised.relaxed.poses
        return self.motion_prior(poses, self._members(optimised)).jumps(poses).tolist()

    def relaxed_from(
        self,
        optimised: Optimised,
        poses: Sequence[Array],
        in_place: bool = False,
        piece: Sequence[int] | None = None,
    ) -> Optimised:
        """The key frames of an optimisation relaxed anew, from other poses (4, 4).

        Args:
            optimised: before.
            poses: T_target_sensor of each.
            in_place: as for :meth:`optimise`.
            piece: number of the piece of each: tracking from one to the next has slipped.
        """
        members, numbers = self._members(optimised), list(piece or [0] * len(poses))
        torn = {k for k, (a, b) in zip(members[1:], pairwise(numbers), strict=True) if a != b}
        relaxed = self._relax_pairs(list(poses), members, in_place, torn)
        relaxed.piece = dict(zip(relaxed.stamps, numbers, strict=True))
        return relaxed

    def _members(self, optimised: Optimised) -> list[int]:
        return [self.keyframes.index[stamp] for stamp in optimised.stamps]

    def _update_occlusion(self, optimised: Optimised) -> bool:
        """Mark partially occluded views; returns whether any mark changed."""
        members = self._members(optimised)
        views = self.keyframes.views
        occluded = partially_occluded_views([views[k] for k in members], optimised.relaxed.poses)
        unoccluded = {k: n not in occluded for n, k in enumerate(members)}
        changed = [k for k, value in unoccluded.items() if views.is_unoccluded(k) != value]
        for k in changed:
            views.set_unoccluded(k, unoccluded[k])
        return bool(changed)

    def mark_usable(self, optimised: Optimised) -> None:
        """Mark key frames usable for mapping: unoccluded, and consistent with at least one neighbour."""
        consistent: set[int] = set()
        for edge, a in zip(optimised.edges, optimised.relaxed.edge_stats, strict=True):
            if a.overlap > MIN_OVERLAP and a.conflict_ratio < SWITCH_CONFLICT_RATIO:
                consistent |= {edge.i, edge.j}
        members = range(len(optimised.stamps))
        if len(consistent) < (1 - MAX_UNSUPPORTED_SHARE) * len(members):
            consistent = set(members)  # the graph is wrong: left to the verdict
        for n, stamp in enumerate(optimised.stamps):
            k = self.keyframes.index[stamp]
            unoccluded = self.keyframes.views.is_unoccluded(k)
            self.keyframes.frames[k].usable_for_mapping = n in consistent and unoccluded

    def _optimise(self, in_place: bool, calibrations: int) -> Optimised | None:
        pruned = self.graph.prune()
        if not len(pruned):
            return None
        index, active = self.keyframes.index, self.keyframes.active
        on_cycle = sorted({index[stamp] for stamp in pruned.stamps} & set(active))
        if not on_cycle:
            return None

        if in_place:  # of a model, which closed the cycles; what came since was tracked against it
            closed = [self.keyframes.frames[k].T_target_sensor for k in active]
        else:
            closed = self._close_cycles(on_cycle, active)
        optimised = self._relax_pairs(closed, active, in_place)
        return self._calibrated(optimised, active, in_place, calibrations)

    def _calibrated(
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
            freed = self._relaxed_over(
                optimised.edges, optimised.relaxed.poses, active, in_place, PAIR_GATES[-1:] * 2, ENOUGH
            )
            found = self._loss(freed, again)
            if found >= loss:
                views.offset = known  # whatever is alike from all sides is none of the sensor's
                break
            optimised, loss = freed, found
        return optimised

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

    def _relax_pairs(
        self, poses: list[Array], active: list[int], in_place: bool, torn: Collection[int] = ()
    ) -> Optimised:
        """Relax key frames over all pairs that look from similar directions; no link leads to torn ones."""
        return self._relaxed_over(self._pairs(poses, active, torn), poses, active, in_place, PAIR_GATES)

    def _relaxed_over(
        self, edges: list[Edge], poses: list[Array], active: list[int], in_place: bool, gates: Gates,
        least_gain: float = 0.0,
    ) -> Optimised:  # fmt: skip
        seen = [self.keyframes.views[k] for k in active]
        prior = self.motion_prior(poses, active)
        least_gain *= self._nat(active)
        relaxed = relax(seen, poses, edges, self.settings.iterations, gates, prior, least_gain)
        relaxed.poses = self._held(relaxed.poses, active, len(active) if in_place else 1)
        stamps = [self.keyframes.frames[k].stamp_ns for k in active]
        return Optimised(dict(zip(stamps, relaxed.poses, strict=True)), stamps, edges, relaxed)

    def motion_prior(self, poses: Sequence[Array], members: Sequence[int]) -> MotionPrior:
        """The motion through key frames, by their positions, at T_target_sensor (4, 4) each."""
        views, frames = self.keyframes.views, [self.keyframes.frames[k] for k in members]
        linked = [f.linked and k - 1 == j for f, (j, k) in zip(frames[1:], pairwise(members), strict=True)]
        return MotionPrior(
            [f.stamp_ns for f in frames],
            linked,
            poses,
            np.mean([apply(T, views.centroids[k]) for T, k in zip(poses, members, strict=True)], axis=0),
            float(np.median([np.ptp(views[k].points, axis=0).max() for k in members])),
            self._nat(members),
        )

    def _nat(self, members: Sequence[int]) -> float:
        """A nat in the springs' cost, m²: the noise of the points is correlated."""
        resolution = float(np.median([self.keyframes.views[k].resolution for k in members]))
        return resolution**2 / self._information_scale

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

    def _close_cycles(self, members: list[int], active: list[int]) -> list[Array]:
        """Poses of all active key frames after relaxing the members over the graph's own edges."""
        position = {k: n for n, k in enumerate(members)}
        index = self.keyframes.index
        edges = [
            Edge(position[index[e.later_ns]], position[index[e.earlier_ns]], e.probability is not None)
            for e in self.graph.edges()
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

    def _pairs(self, poses: list[Array], active: list[int], torn: Collection[int]) -> list[Edge]:
        """Edges between active key frames seen from similar directions that overlap, and odometry edges."""
        s = self.settings
        views = [self.keyframes.views[k] for k in active]
        frames = self.keyframes.frames
        linked = [frames[k].linked and not frames[k].slipped and k not in torn for k in active]
        angles = angles_between(views, poses)
        near: set[tuple[int, int]] = set()
        for k in range(len(poses)):
            for m in np.argsort(angles[k], kind='stable')[: s.pairs + 1]:
                if m != k and angles[k, m] < np.radians(s.pair_angle_deg):
                    near.add((max(k, int(m)), min(k, int(m))))
        edges = []
        for i, j in sorted(near):
            if i == j + 1 and linked[i]:
                continue
            a = linearise_shapes(views[i], poses[i], views[j], poses[j], GATE).stats
            if a.overlap > MIN_OVERLAP:
                edges.append(Edge(i, j, is_closure=True))
        return [Edge(k, k - 1, is_closure=False) for k in range(1, len(poses)) if linked[k]] + edges


def _shows_occlusion(other: View, T_other: Array, view: View, T_view: Array) -> bool:
    """Whether another view has points that are occluded in this one, and contradicts none of its points."""
    seen = linearise(other, T_other, view, T_view, GATE).stats
    missing = seen.outside_mask / max(1.0, seen.visible + seen.outside_mask)
    if missing < MIN_MISSING_RATIO or seen.conflict_ratio > MAX_CONFLICT_RATIO:
        return False
    own = linearise(view, T_view, other, T_other, GATE).stats
    return (
        own.silhouette_violation_ratio < MAX_SILHOUETTE_VIOLATION
        and own.conflict_ratio < MAX_CONFLICT_RATIO
        and own.rms < MAX_RMS
    )
