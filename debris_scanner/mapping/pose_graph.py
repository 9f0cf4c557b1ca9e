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

"""Key frames that show a half hidden target, though odometry took them for whole: the others tell.

What came into sight behind a shadow's edge had never been seen, so nothing was missed. Once loops are closed
other key frames show it: a part of them lies beside this one's silhouette, while nothing of this one
contradicts them. Of a frame that is out of place something would.

Pose graph of the scan: which key frames belong together, and where they are once relaxed.

A closure makes a cycle; pruning keeps the key frames on cycles (Trowbridge 2014, section 3.2), and
relaxation shares the drift out among them. Then every pair of key frames that look from nearby
becomes an edge too, and all key frames are relaxed together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import Array, apply, compose, inverse, project_so3, transform
from debris_scanner.core.parameters import parameter
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.frame_graph import FrameGraph, FrameGraphSettings
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.relaxation import SWITCH_CONFLICT_RATIO, Edge, Relaxed, relax
from debris_scanner.registration.projective import linearise, linearise_pair
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View, angles_between

REACH = np.radians(70.0)  # other views from so near are asked,
WITNESSES = 12  # at most
MIN_WITNESSES = 2  # and so many must tell
MISSING = 0.15  # of their points that should show, beside the silhouette
MAX_SILHOUETTE_VIOLATION, MAX_CONFLICT_RATIO = (
    0.06,
    0.035,
)  # and of its own points, which lie where they have them,
MAX_RMS = 0.0023  # m
MOST = 0.25  # of the views: more, and it is the poses that are wrong
GATE = 0.012  # m


def partially_occluded_views(views: Sequence[View], poses: Sequence[Array]) -> set[int]:
    """Indices of the views (T_target_view (4, 4) each) of which the others show that a part is hidden."""
    angles = angles_between(views, poses)
    occluded = set()
    for k in range(len(views)):
        near = [int(m) for m in np.argsort(angles[k], kind='stable') if m != k and angles[k, m] < REACH]
        telling = 0
        for m in near[:: max(1, len(near) // WITNESSES)]:  # not the latest alone: they are hidden alike
            telling += _shows_occlusion(views[m], poses[m], views[k], poses[k])
            if telling == MIN_WITNESSES:
                occluded.add(k)
                break
    return occluded if len(occluded) <= MOST * len(views) else set()


def _shows_occlusion(other: View, T_other: Array, view: View, T_view: Array) -> bool:
    """Whether another view shows that something is hidden in this one, and contradicts nothing of it."""
    seen = linearise(other, T_other, view, T_view, GATE).stats
    missing = seen.outside_mask / max(1.0, seen.visible + seen.outside_mask)
    if missing < MISSING or seen.conflict_ratio > MAX_CONFLICT_RATIO:
        return False
    own = linearise(view, T_view, other, T_other, GATE).stats
    return (
        own.silhouette_violation_ratio < MAX_SILHOUETTE_VIOLATION
        and own.conflict_ratio < MAX_CONFLICT_RATIO
        and own.rms < MAX_RMS
    )


MOST_ALONE = 0.25  # of the key frames may be left out since no neighbour agrees with them


@dataclass(frozen=True)
class PoseGraphSettings:
    """Which pairs of key frames become edges, and how long they are relaxed."""

    pair_angle_deg: float = parameter(
        28.0, 'key frames seen from closer than this are paired', 'deg', 1.0, 90.0
    )
    pairs: int = parameter(8, 'most pairs a key frame starts', '', 1, 100)
    min_overlap: float = parameter(
        0.5, 'share of points a pair must have in common to be an edge', '', 0.0, 1.0
    )
    iterations: int = parameter(12, 'most relaxation iterations', '', 1, 1000)


@dataclass
class Optimised:
    """Relaxed key frames: indices into the key frame set, poses, edges and their agreement."""

    poses: dict[int, Array]  # T_target_sensor by stamp
    stamps: list[int]
    edges: list[Edge]  # between positions in ``stamps``
    relaxed: Relaxed


class PoseGraph:
    """Grows with key frames and closures; ``optimise`` relaxes what hangs together."""

    def __init__(self, settings: PoseGraphSettings, normals: NormalSettings) -> None:
        self.settings = settings
        self.keyframes = KeyFrameSet(normals)
        self.closures: list[Closure] = []  # accepted ones
        self.graph = FrameGraph(FrameGraphSettings())

    def add_keyframe(self, keyframe: KeyFrame) -> None:
        """Append a key frame; odometry vouches for the edge to the one before, but for a submap's first."""
        self.keyframes.add(keyframe)
        self.graph.add_frame(keyframe.stamp_ns, linked=self.keyframes.frames[-1].linked)

    def add_closure(self, closure: Closure) -> None:
        """Add an accepted closure; between two submaps it joins them.

        Raises:
            ValueError: if one of its key frames is not here.
        """
        self.keyframes.join(closure.from_stamp_ns, closure.to_stamp_ns, closure.T_from_to)
        self.graph.add_closure(closure.from_stamp_ns, closure.to_stamp_ns, closure.probability)
        self.closures.append(closure)

    def drop_closures(self, refused: Optimised, newest: bool) -> None:
        """Forget the closures that a refused optimisation bent off, or else, if so said, the newest one."""
        rejected_closures = {
            (refused.stamps[e.j], refused.stamps[e.i])
            for e, w in zip(refused.edges, refused.relaxed.weights, strict=True)
            if e.is_closure and w < 0.5
        }
        kept = [c for c in self.closures if (c.from_stamp_ns, c.to_stamp_ns) not in rejected_closures]
        if len(kept) == len(self.closures) and newest:
            kept = kept[:-1]
        self.closures = kept
        self.graph = FrameGraph(FrameGraphSettings())
        for keyframe in self.keyframes.frames:
            self.graph.add_frame(keyframe.stamp_ns, linked=keyframe.linked)
        for c in self.closures:
            self.graph.add_closure(c.from_stamp_ns, c.to_stamp_ns, c.probability)

    def optimise(self, in_place: bool = False) -> Optimised | None:
        """Relaxed poses of all active key frames, or None when no cycle of theirs survives pruning.

        Args:
            in_place: on average the target stays where it was; or else the first key frame's attitude does.
                Were a target that is tracked held by one key frame, it would jump by the error of that.
        """
        optimised = self._optimise(in_place)
        if optimised is not None and self._uncover(optimised):
            optimised = self._optimise(in_place)
        if optimised is not None:
            self._judge_keyframes(optimised)
        return optimised

    def _uncover(self, optimised: Optimised) -> bool:
        """Note which views turn out to be half hidden; whether that is news."""
        members = [self.keyframes.index[stamp] for stamp in optimised.stamps]
        views = self.keyframes.views
        occluded = partially_occluded_views([views[k] for k in members], optimised.relaxed.poses)
        told = {k: n not in occluded for n, k in enumerate(members)}
        news = [k for k, whole in told.items() if views.is_unoccluded(k) != whole]
        for k in news:
            views.judge(k, told[k])
        return bool(news)

    def _judge_keyframes(self, optimised: Optimised) -> None:
        """Note which key frames are fit for a model: of one found elsewhere by a lucky fit no pair agrees."""
        vouched: set[int] = set()
        for edge, a in zip(optimised.edges, optimised.relaxed.edge_stats, strict=True):
            if a.overlap > self.settings.min_overlap and a.conflict_ratio < SWITCH_CONFLICT_RATIO:
                vouched |= {edge.i, edge.j}
        members = range(len(optimised.stamps))
        if len(vouched) < (1 - MOST_ALONE) * len(members):
            vouched = set(members)  # it is the graph that is wrong: the verdict's matter
        for n, stamp in enumerate(optimised.stamps):
            k = self.keyframes.index[stamp]
            self.keyframes.frames[k].usable_for_mapping = n in vouched and self.keyframes.views.is_unoccluded(
                k
            )

    def _optimise(self, in_place: bool) -> Optimised | None:
        pruned = self.graph.prune()
        if not len(pruned):
            return None
        index, views = self.keyframes.index, self.keyframes.views
        active = self.keyframes.active
        on_cycle = sorted({index[stamp] for stamp in pruned.stamps} & set(active))
        if not on_cycle:
            return None
        poses = self._close_cycles(on_cycle, active)
        edges = self._pairs(poses, active)
        seen = [views[k] for k in active]
        relaxed = relax(seen, poses, edges, self.settings.iterations, gates=(0.010, 0.006))
        relaxed.poses = self._held(relaxed.poses, active, len(active) if in_place else 1)
        stamps = [self.keyframes.frames[k].stamp_ns for k in active]
        return Optimised(dict(zip(stamps, relaxed.poses, strict=True)), stamps, edges, relaxed)

    def _held(self, poses: list[Array], active: list[int], count: int) -> list[Array]:
        """The poses moved together, so that of the first ones, as many as said, on average nothing moves."""
        M, was, now = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        for k, T in zip(active[:count], poses, strict=False):
            before, seen = self.keyframes.frames[k].T_target_sensor, self.keyframes.views.centroids[k]
            M += before[:3, :3] @ T[:3, :3].T
            was, now = was + apply(before, seen) / count, now + apply(T, seen) / count
        R = project_so3(M)
        T_held_relaxed = transform(R, was - R @ now)
        return [compose(T_held_relaxed, T) for T in poses]

    def _close_cycles(self, members: list[int], active: list[int]) -> list[Array]:
        """Poses of all active key frames after relaxing the given ones over the graph's own edges."""
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
        )
        poses = []
        for k in active:
            nearest = min(members, key=lambda m: abs(m - k))
            poses.append(compose(relaxed.poses[position[nearest]], inverse(before[nearest]), before[k]))
        return poses

    def _pairs(self, poses: list[Array], active: list[int]) -> list[Edge]:
        """Edges between active key frames that look from nearby and agree, linked ones in any case."""
        s = self.settings
        views = [self.keyframes.views[k] for k in active]
        linked = [self.keyframes.frames[k].linked for k in active]
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
            a = linearise_pair(views[i], poses[i], views[j], poses[j], 0.012).stats
            if a.overlap > s.min_overlap:
                edges.append(Edge(i, j, is_closure=True))
        return [Edge(k, k - 1, is_closure=False) for k in range(1, len(poses)) if linked[k]] + edges
