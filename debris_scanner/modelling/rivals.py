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

"""Rival explanations of a scan: other poses of its key frames, which take their place if they agree better.

Relaxation moves poses by small steps. What odometry took for another motion from the first needs a large one.

- A scan that is bent evenly holds itself so: the pairs that contradict its steps are set aside. One step to
  where all pairs want the views straightens it.
- A nearly round target that seemed to stand still at first may have turned evenly throughout
  (:meth:`~debris_scanner.mapping.motion_prior.MotionPrior.evened`).
- While the rate jumps, as of a turntable that stops and starts, and while the target is out of sight, nothing
  says how far it turns but what is seen then; of a nearly round target that is little. Later views from all
  sides tell more together. So what comes after such a moment is turned, as one piece, all the way about the
  axis that the views say least about, and settles where it agrees best with the others (:func:`put_back`).
- A part may have slid along a wide face, step by step. The verdict says where the others want it: it is put
  back there (:func:`slid_back`).
- Of a nearly round target the whole motion may be longer or shorter than it seems, where each step falls
  short by a little. The scan climbs to where its views agree best (:func:`climb`). Whether they would agree
  as well elsewhere is asked (:func:`least_stretch_loss`); if they would, nobody knows which it was.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, compose
from debris_scanner.mapping.bridging import FreeMotion
from debris_scanner.mapping.optimiser import Optimised
from debris_scanner.mapping.pose_graph import PoseGraph
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.ambiguity import (
    least_turning_loss,
    moved_elsewhere,
    turned_about,
    weakest_axis,
)
from debris_scanner.modelling.climbing import (
    LEAST_GAIN,
    climbed,
    main_axes,
    moved_far,
    travelled,
    turned_along,
)
from debris_scanner.modelling.consistency import (
    SOME,
    agreement,
    agreement_across,
    least_cost,
    pairs_across,
    settle,
    settled_together,
)
from debris_scanner.modelling.validation import AFTER_GAP, VerdictSettings
from debris_scanner.sensing.sensor_model import SensorModel

TURNS = np.radians(np.arange(15.0, 360.0, 15.0))  # closer than what settles to the same place
WIDE = 3.0  # factor on the noise while turned parts are compared
SETTLED = 2  # of the turned parts: the best ones
MOST_TURNED = 8  # pieces, one after the other
STRETCH = 0.1  # of what the target turned: odometry of real sensors is off by 1 to 20 % of a turn


@dataclass(frozen=True)
class PutBack:
    """Key frames after parts of them were turned back."""

    poses: Sequence[Array]  # T_target_view (4, 4)
    piece: NDArray[np.intp]  # (n,), counted from the first; each was turned by itself


def best_explanation(
    optimised: Optimised,
    graph: PoseGraph,
    sensor: SensorModel,
    gaps: Sequence[int],
    accepted_loss: float,
    verdict: VerdictSettings,
    in_place: bool,
) -> Optimised:
    """The relaxed key frames, or a rival that explains their views better.

    Args:
        optimised: as relaxed from where they were tracked.
        graph: that they are of.
        sensor: noise measured on the stream.
        gaps: indices of key frames before which the target was out of sight.
        accepted_loss: nats a point, of a frame that is taken; where a turn costs more, none slips unnoticed.
        verdict: bounds; what gains more elsewhere lies wrong, and where a turn costs all views next to
            nothing, they say nothing of where a part lies.
        in_place: as for :meth:`PoseGraph.optimise`.
    """
    best, posed = _gathered(optimised, _posed(optimised, graph, sensor), graph, in_place)
    evenly = graph.evened(best, in_place)
    if evenly is not None:
        rival = posed.posed(evenly.relaxed.poses)
        if agreement(rival) > agreement(posed):
            best, posed = evenly, rival
    cuts = sorted({*graph.jumps(best), *gaps})
    linked, followed = ([k not in breaks for k in range(len(posed.views))] for breaks in (cuts, gaps))
    motion = FreeMotion(best.stamps, linked, followed)
    least_loss = AFTER_GAP * verdict.min_turning_loss
    slips = _may_slip(posed, cuts, accepted_loss, least_loss)
    if slips and (found := put_back(posed, cuts, verdict.max_gain, motion)):
        turned = graph.relaxed_from(best, found.poses, in_place, found.piece.tolist())
        rival = posed.posed(turned.relaxed.poses)
        if agreement(rival) > agreement(posed):
            best, posed = turned, rival
    if best is not optimised:
        graph.mark_usable(best)
    return best


def _gathered(
    best: Optimised, posed: PosedViews, graph: PoseGraph, in_place: bool
) -> tuple[Optimised, PosedViews]:
    """The key frames relaxed from where all pairs together want them, while they agree better there.

    Relaxation sets pairs aside that contradict the steps between them. Where the steps bend a scan evenly
    these are the pairs of later and earlier views of one side: that no arc is out of place hides it.
    """
    while True:
        poses = settled_together(posed.coarse())
        if agreement(posed.coarse().posed(poses)) < agreement(posed.coarse()) + LEAST_GAIN:
            return best, posed
        if (rival := _gaining(best, posed, poses, graph, in_place)) is None:
            return best, posed
        best, posed = rival


def _gaining(
    best: Optimised, posed: PosedViews, poses: Sequence[Array], graph: PoseGraph, in_place: bool
) -> tuple[Optimised, PosedViews] | None:
    """The key frames relaxed from other poses (4, 4), in the same pieces; None if they agree no better."""
    rival = graph.relaxed_from(best, poses, in_place, [best.piece.get(s, 0) for s in best.stamps])
    there = posed.posed(rival.relaxed.poses)
    return (rival, there) if agreement(there) >= agreement(posed) + LEAST_GAIN else None


def slid_back(
    optimised: Optimised,
    graph: PoseGraph,
    sensor: SensorModel,
    slid: Collection[int],
    move: Array,
    in_place: bool,
) -> Optimised | None:
    """The key frames relaxed anew after those that slid were put back; None if they agree no better.

    Args:
        optimised: the key frames, relaxed.
        graph: that they are of.
        sensor: noise measured on the stream.
        slid: stamps of those that slid.
        move: (4, 4), to where the others want them.
        in_place: as for :meth:`PoseGraph.optimise`.
    """
    posed = _posed(optimised, graph, sensor)
    moved = [compose(move, T) if s in slid else T for s, T in zip(optimised.stamps, posed.poses, strict=True)]
    found = _gaining(optimised, posed, moved, graph, in_place)
    if found is None:
        return None
    graph.mark_usable(found[0])
    return found[0]


def climb(
    optimised: Optimised, graph: PoseGraph, sensor: SensorModel, accepted_loss: float, in_place: bool
) -> Optimised:
    """The key frames where turns along the scan lead them, relaxed; as they are if nothing is gained.

    Args:
        optimised: the key frames, of a nearly round target.
        graph: that they are of.
        sensor: noise measured on the stream.
        accepted_loss: nats a point; where a turn costs more, there is nothing to climb.
        in_place: as for :meth:`PoseGraph.optimise`.
    """
    best, posed = optimised, _posed(optimised, graph, sensor)
    while (poses := climbed(posed)) is not None:
        if (rival := _gaining(best, posed, poses, graph, in_place)) is None:
            break
        best, posed = rival
        if least_turning_loss(posed.coarse())[0] >= accepted_loss:
            break
    if best is not optimised:
        graph.mark_usable(best)
    return best


def least_stretch_loss(
    optimised: Optimised, graph: PoseGraph, sensor: SensorModel, accepted_loss: float, in_place: bool
) -> float:
    """What a point loses if the target turned a tenth more or less than it seems, nats.

    Each step may fall short unnoticed even where half of the scan could not turn: that of a shell whose rim
    comes round now and then. The whole motion is stretched, about its own axis and about the one that the
    views say least about, wherever the views give way to that, and relaxed: odometry that falls short by so
    much leaves a scan there, and real ones do. Infinite if no view gives way, or each of these rivals came
    back.

    Args:
        optimised: the key frames, relaxed.
        graph: that they are of.
        sensor: noise measured on the stream.
        accepted_loss: nats a point, of a frame that is taken; what costs more is noticed.
        in_place: as for :meth:`PoseGraph.optimise`.
    """
    posed, least = _posed(optimised, graph, sensor), np.inf
    few, path = posed.coarse(), STRETCH * travelled(posed.poses)
    for axis in main_axes(few):
        if least_cost(few, np.hstack([np.outer(path, axis), np.zeros((len(path), 3))])) >= accepted_loss:
            continue
        for stretch in (path, -path):
            poses = turned_along(posed, stretch, axis)
            relaxed = graph.relaxed_from(optimised, poses, in_place, views=few.views).relaxed
            if moved_far(posed.poses, relaxed.poses):
                least = min(least, agreement(posed) - agreement(posed.posed(relaxed.poses)))
    return float(least)


def _posed(optimised: Optimised, graph: PoseGraph, sensor: SensorModel) -> PosedViews:
    """The key frames where they were relaxed to."""
    views = [graph.keyframes.views[graph.keyframes.index[stamp]] for stamp in optimised.stamps]
    return PosedViews(views, optimised.relaxed.poses, sensor)


def _may_slip(posed: PosedViews, cuts: Sequence[int], accepted_loss: float, least_loss: float) -> bool:
    """Whether a part between two cuts could be turned unnoticed, while the scan as a whole could not."""
    if not cuts:
        return False
    part, coarse = np.searchsorted(cuts, np.arange(len(posed.views)), side='right'), posed.coarse()
    if least_turning_loss(coarse)[0] < least_loss:
        return False
    return any(least_turning_loss(coarse, part == k)[0] < accepted_loss for k in range(len(cuts) + 1))


def put_back(posed: PosedViews, cuts: Sequence[int], max_gain: float, motion: FreeMotion) -> PutBack | None:
    """Poses at which parts of a scan agree better with the others; None where none does.

    Args:
        posed: key frames.
        cuts: indices of those before which the target may have turned unnoticed.
        max_gain: nats a point of the pairs with the others; what gains more elsewhere lies wrong.
        motion: of the key frames; where it does not lead, a part cannot be.
    """
    best, used, dismissed = posed, set[int](), set[tuple[int, int | None]]()
    for _ in range(MOST_TURNED):
        tried = []
        ends = {(cut, end) for cut in cuts for end in (_next(cuts, cut), _next(used, cut), None)}
        for first, end in sorted(ends - dismissed, key=str):
            gaining = [rival for gain, rival in _turned(best, slice(first, end), motion) if gain > max_gain]
            tried += [(agreement(rival), (first, end), rival) for rival in gaining]
            if not gaining:
                dismissed.add((first, end))
        if not tried:
            break
        _, (first, end), best = max(tried, key=lambda found: found[0])
        used |= {first} if end is None else {first, end}
    piece = np.searchsorted(sorted(used), np.arange(len(posed.views)), side='right')
    return PutBack(best.poses, piece) if used else None


def _next(cuts: Collection[int], cut: int) -> int | None:
    return min((later for later in cuts if later > cut), default=None)


def _turned(posed: PosedViews, piece: slice, motion: FreeMotion) -> Iterator[tuple[float, PosedViews]]:
    """The views with a piece of them turned, and settled, where it agrees best with the others.

    With what a point of the pairs with the others gains.
    """
    inside = np.zeros(len(posed.views), np.bool_)
    inside[piece] = True
    here = agreement_across(posed, inside)
    if here is None:
        return
    axis, about = weakest_axis(posed)
    tried = []
    for turn in TURNS:
        rival = posed.posed(posed.moved(inside, turned_about(axis, turn, about), posed.poses))
        there = agreement_across(rival, inside, WIDE, SOME)
        if there is not None:
            tried.append((there, rival))
    tried.sort(key=lambda found: -found[0])
    for _, rival in tried[:SETTLED]:
        poses = settle(rival, inside, rival.poses, pairs_across(rival, inside))
        settled = posed.posed(poses)
        there = agreement_across(settled, inside)
        # nearer places are found by relaxation
        if there is not None and moved_elsewhere(posed, poses, inside) and motion.leads(poses, inside):
            yield there - here, settled
