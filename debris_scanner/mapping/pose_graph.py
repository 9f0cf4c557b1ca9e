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
edge too, and all key frames are relaxed together (:mod:`debris_scanner.mapping.optimiser`). The relaxed poses
also reveal partially occluded key frames (:mod:`debris_scanner.mapping.occluded_views`).
"""

from collections.abc import Collection, Sequence
from itertools import pairwise

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import Array
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.frame_graph import FrameGraph, FrameGraphSettings
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.occluded_views import partially_occluded_views
from debris_scanner.mapping.optimiser import Optimised, Optimiser, PoseGraphSettings
from debris_scanner.mapping.relaxation import SWITCH_CONFLICT_RATIO
from debris_scanner.registration.projective import MIN_OVERLAP
from debris_scanner.sensing.depth_offset import NO_OFFSET
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View

MAX_UNSUPPORTED_SHARE = 0.25  # of the key frames, with no neighbour that agrees; beyond, the graph is wrong
CALIBRATIONS = 3  # of the sensor at the end of a scan: poses and offset are linearised anew


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
        views: Sequence[View] | None = None,
    ) -> Optimised:
        """The key frames of an optimisation relaxed anew, from other poses (4, 4).

        Args:
            optimised: before.
            poses: T_target_sensor of each.
            in_place: as for :meth:`optimise`.
            piece: number of the piece of each: tracking from one to the next has slipped.
            views: as for :meth:`Optimiser.relaxed`.
        """
        members, numbers = self._members(optimised), list(piece or [0] * len(poses))
        torn = {k for k, (a, b) in zip(members[1:], pairwise(numbers), strict=True) if a != b}
        relaxed = self._optimiser.relaxed(list(poses), members, in_place, torn, views)
        relaxed.piece = dict(zip(relaxed.stamps, numbers, strict=True))
        return relaxed

    def motion_prior(self, poses: Sequence[Array], members: Sequence[int]) -> MotionPrior:
        """See :meth:`Optimiser.motion_prior`."""
        return self._optimiser.motion_prior(poses, members)

    @property
    def _optimiser(self) -> Optimiser:
        return Optimiser(self.keyframes, self.settings, self._information_scale)

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
        index, active, optimiser = self.keyframes.index, self.keyframes.active, self._optimiser
        on_cycle = sorted({index[stamp] for stamp in pruned.stamps} & set(active))
        if not on_cycle:
            return None

        if in_place:  # of a model, which closed the cycles; what came since was tracked against it
            closed = [self.keyframes.frames[k].T_target_sensor for k in active]
        else:
            closed = optimiser.closed(self.graph, on_cycle, active)
        optimised = optimiser.relaxed(closed, active, in_place)
        return optimiser.calibrated(optimised, active, in_place, calibrations)
