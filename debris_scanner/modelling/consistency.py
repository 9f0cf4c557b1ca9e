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

"""The arc test: do the posed key frames agree, and if not, which of them are out of place?

Pairs of key frames that look from similar directions are compared by their likelihood, each linearised once.
Every arc of consecutive key frames is then tried as a rigid piece. The pairs across its ends say where it
should lie, and how much better they would fit there, in nats a point (:func:`worst_arc`). A piece that lies
too far off to find its way shows where it was torn from what it had been tracked with (:func:`worst_link`).
A piece that slid along a wide face, step by step, was torn nowhere. So the arcs that agree less with the
others than with their neighbours are tried elsewhere (:func:`worst_shifted_arc`).

Frames are judged against frames. A fused model holds the wrong ones too, and its voxels hide what is wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, inverse, rotation_angle, solve_informed
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.mapping.relaxation import given_way, newton_step
from debris_scanner.registration.likelihood import PairLikelihood

WIDE = 4.0  # factor on the noise, to see what is far out of place
SETTLING = (6.0, 3.0, 1.5, 1.0)  # factors on the noise while an arc settles
SOME = 3  # one of so many pairs tells where to look; all are asked of what it found
CANDIDATES = 2  # arcs that settle, of each way to choose them
FEWEST = 100  # points across an arc's ends; fewer tell nothing
ELSEWHERE = np.radians(10.0)  # turned by so much a part is at another place
SHIFTS = (-0.4, -0.2, 0.2, 0.4)  # of the depth within which what is no hit lies: from there an arc settles


@dataclass(frozen=True)
class Arc:
    """Key frames ``first`` to ``last`` as one rigid piece."""

    first: int
    last: int

    @property
    def length(self) -> int:
        """Number of key frames."""
        return self.last - self.first + 1


@dataclass(frozen=True)
class Displacement:
    """Where the other key frames would rather have an arc."""

    arc: Arc
    turn: float  # rad
    shift: float  # m, of the target's centre
    gain: float  # nats a point that the pairs across its ends gain there
    move: Array  # (4, 4), of the arc's poses


def worst_arc(posed: PosedViews) -> Displacement | None:
    """The arc that the other key frames most want elsewhere; None for fewer than three key frames.

    Arcs are tried that promise most, with the noise as it is and with more.
    """
    if len(posed.views) < 3:
        return None
    inside = arcs(len(posed.views))
    best: list[int] = []
    for widen in (1.0, WIDE):
        terms = posed.pairs_at(posed.pairs, widen)
        for promise in _promises(inside, posed.pairs, terms):
            best += [int(k) for k in np.argsort(-promise)[:CANDIDATES]]
    return max((_settled(posed, inside[k]) for k in dict.fromkeys(best)), key=lambda d: d.gain)


def worst_shifted_arc(posed: PosedViews) -> Displacement | None:
    """The arc that gains most by a shift along its main axes, from where it settles; None if none may gain.

    Those are tried whose views agree less with the others than with their neighbours: no place makes up for
    more than that. What slid did not turn.
    """
    if len(posed.views) < 3:
        return None
    tried = (_shifted(posed, inside) for inside in _disagreeing_arcs(posed))
    return max(tried, key=lambda d: d.gain, default=None)


def worst_link(posed: PosedViews, before: Sequence[Array], links: Sequence[int]) -> Displacement | None:
    """The step that fits best as it was tracked, compared with how it is posed now; None without any.

    A part of the scan that was turned far away by a false closure can not find its way back by small steps.
    But where it was torn off, two key frames that had been registered to each other are no longer.

    Args:
        posed: key frames.
        before: T_target_view (4, 4) as tracked.
        links: indices of key frames that tracking connects with the one before.
    """
    steps = []
    for k in links:
        T_tracked = compose(posed.poses[k - 1], inverse(before[k - 1]), before[k])
        tracked, now = list(posed.poses), posed.poses[k]
        tracked[k] = T_tracked
        gain = a_point([posed.pair(k - 1, k, poses=tracked)]) - a_point([posed.pair(k - 1, k)])
        steps.append(_displacement(posed, Arc(k, k), compose(T_tracked, inverse(now)), gain))
    return max(steps, key=lambda d: d.gain, default=None)


def agreement(posed: PosedViews, every: int = 1) -> float:
    """How well the posed views explain each other, nats a point, by one of so many pairs."""
    return a_point(posed.pairs_at(posed.pairs[::every]))


def pairs_across(posed: PosedViews, inside: NDArray[np.bool_], apart: int = 2) -> list[tuple[int, int]]:
    """Pairs of which one view is inside (n,), so far apart in time: two in a row may be posed anywhere."""
    return [(i, j) for i, j in posed.pairs if inside[i] != inside[j] and j - i >= apart]


def agreement_across(
    posed: PosedViews, inside: NDArray[np.bool_], widen: float = 1.0, every: int = 1
) -> float | None:
    """How well the views inside (n,) agree with the others, nats a point; None with too little in common.

    Args:
        posed: key frames.
        inside: the part.
        widen: factor on the noise.
        every: one of so many pairs is asked, where many places are compared.
    """
    terms = posed.pairs_at(pairs_across(posed, inside)[::every], widen)
    return a_point(terms) if every * sum(t.points for t in terms) >= FEWEST else None


def a_point(pairs: Sequence[PairLikelihood]) -> float:
    """Of all points of some pairs, nats."""
    return sum(p.log_likelihood for p in pairs) / max(1.0, sum(p.points for p in pairs))


def settle(
    posed: PosedViews, inside: NDArray[np.bool_], poses: Sequence[Array], across: Sequence[tuple[int, int]]
) -> Sequence[Array]:
    """Poses after the views inside (n,) were moved as one piece to where the pairs across want them."""
    for widen in SETTLING:
        H, g = np.zeros((6, 6)), np.zeros(6)
        for (i, _), pair in zip(across, posed.pairs_at(across, widen, poses), strict=True):
            H, g = H + pair.H, g + (pair.g if inside[i] else -pair.g)
        poses = posed.moved(inside, -solve_informed(H, g), poses)
    return poses


def settled_together(posed: PosedViews) -> list[Array]:
    """Poses (4, 4) after one Newton step of all views but the first to where all pairs want them."""
    pairs = posed.pairs_at(posed.pairs)
    H, g = np.array([p.H for p in pairs]), np.array([p.g for p in pairs])
    steps = newton_step(posed.pairs, H, g, len(posed.views))
    return [posed.moved_pose(step, T) for step, T in zip(steps, posed.poses, strict=True)]


def least_cost(posed: PosedViews, motion: Array) -> float:
    """The least that a point loses, nats, by a motion to which the views give way, by the pairs' information.

    Args:
        posed: key frames.
        motion: (n, 6), twists about the centre; the first is zero. Any other motion counts as this one if its
            product with it is the same.
    """
    pairs = posed.pairs_at(posed.pairs)
    given = given_way(posed.pairs, np.array([p.H for p in pairs]), motion)
    along, points = float(np.sum(motion * given)), sum(p.points for p in pairs)
    return 0.5 * float(np.sum(motion**2)) ** 2 / along / max(points, 1.0) if along > 0 else np.inf


def arcs(n: int) -> NDArray[np.bool_]:
    """Arcs (m, n): runs of 1, 2, 4 ... n/2 key frames, overlapping by three quarters."""
    rows, length = [], 1
    while length <= max(1, n // 2):
        for first in range(0, n - length + 1, max(1, length // 4)):
            row = np.zeros(n, np.bool_)
            row[first : first + length] = True
            rows.append(row)
        length *= 2
    return np.array(rows)


def arc(inside: NDArray[np.bool_]) -> Arc:
    """Of the views inside (n,)."""
    members = np.flatnonzero(inside)
    return Arc(int(members[0]), int(members[-1]))


def across_ends(inside: NDArray[np.bool_], pairs: Sequence[tuple[int, int]]) -> Array:
    """Of each arc and pair (m, p): 1 if only the pair's first view is inside, -1 if only its second is."""
    i, j = np.array(pairs).T
    return inside[:, i].astype(float) - inside[:, j]


def _promises(
    inside: NDArray[np.bool_], pairs: Sequence[tuple[int, int]], terms: Sequence[PairLikelihood]
) -> tuple[Array, Array]:
    """What each arc (m,) would gain by its best small motion: in nats, and in nats a point."""
    across = across_ends(inside, pairs)
    H = np.abs(across) @ np.array([t.H.ravel() for t in terms])
    g = across @ np.array([t.g for t in terms])
    points = np.abs(across) @ np.array([t.points for t in terms])
    gain = np.array([0.5 * b @ solve_informed(A.reshape(6, 6), b) for A, b in zip(H, g, strict=True)])
    gain[points < FEWEST] = 0
    return gain, gain / np.maximum(points, 1)


def _disagreeing_arcs(posed: PosedViews) -> list[NDArray[np.bool_]]:
    """The arcs (n,) whose views agree most less with the others than with their neighbours.

    All runs of at most half of the views are compared, by nats a point, for a part that slid begins and ends
    anywhere. Of runs that share more than they differ, the first one stands for all.
    """
    n, (i, j) = len(posed.views), np.array(posed.pairs).T
    terms = posed.pairs_at(posed.pairs)
    nats, points = (np.array(of) for of in ([t.log_likelihood for t in terms], [t.points for t in terms]))
    near = j - i == 1
    of_both = np.concatenate([i[near], j[near]])
    own, seen = (np.bincount(of_both, np.tile(of[near], 2), minlength=n) for of in (nats, points))
    level = own / np.maximum(seen, 1)
    missed = np.minimum(level[i], level[j]) * points - nats
    far = (i[~near], j[~near])
    total, lost = (_sums_across(far, of[~near], n) for of in (points, missed))
    first, last = np.indices((n, n))
    length = last - first + 1
    possible = (length > 0) & (length <= max(1, n // 2)) & (total >= FEWEST)
    a_point_lost = np.where(possible, lost / np.maximum(total, 1), -np.inf)
    chosen: list[NDArray[np.bool_]] = []
    while len(chosen) < CANDIDATES and a_point_lost.max() > 0:
        begin, end = np.unravel_index(a_point_lost.argmax(), a_point_lost.shape)
        chosen.append((np.arange(n) >= begin) & (np.arange(n) <= end))
        shared = np.minimum(last, end) - np.maximum(first, begin) + 1
        a_point_lost[2 * shared > length + (end - begin + 1) - shared] = -np.inf
    return chosen


def _sums_across(pairs: tuple[NDArray[np.intp], NDArray[np.intp]], values: Array, n: int) -> Array:
    """Sums (n, n) over the pairs with one view in the run from the first to the last index."""
    of = np.zeros((n, n))
    of[pairs] = values
    ends = np.concatenate([[0.0], np.cumsum(of.sum(axis=0) + of.sum(axis=1))])
    within = np.pad(of.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    first, after = np.arange(n)[:, None], np.arange(1, n + 1)[None]
    both = within[after, after] - within[first, after] - within[after, first] + within[first, first]
    return np.asarray(ends[after] - ends[first] - 2 * both)


def _shifted(posed: PosedViews, inside: NDArray[np.bool_]) -> Displacement:
    """Where an arc settles from shifts along the main axes of what it shows, and what its pairs gain."""
    few, across = posed.coarse(), pairs_across(posed, inside, 1)
    members = zip(few.views, few.poses, inside, strict=True)
    seen = np.concatenate([apply(T, v.points.astype(float)) for v, T, k in members if k])
    k, found = int(np.argmax(inside)), []
    for axis in np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2]:
        for shift in SHIFTS:
            twist = np.concatenate([np.zeros(3), shift * posed.beam.extent * axis])
            there = few.moved(inside, twist, few.poses)
            poses = settle(few, inside, there, pairs_across(few.posed(there), inside))
            move = compose(poses[k], inverse(posed.poses[k]))
            if rotation_angle(move[:3, :3]) <= ELSEWHERE:
                found.append((a_point(few.pairs_at(across, 1.0, poses)), poses, move))
    gain, move = 0.0, np.eye(4)
    if found:  # all points are asked of the best place
        _, best, best_move = max(found, key=lambda place: place[0])
        after = posed.pairs_at(across, 1.0, best)
        if sum(t.points for t in after) >= FEWEST:
            gain, move = a_point(after) - a_point(posed.pairs_at(across)), best_move
    return _displacement(posed, arc(inside), move, gain)


def _settled(posed: PosedViews, inside: NDArray[np.bool_]) -> Displacement:
    """Where an arc settles, and what the pairs across its ends gain."""
    across = [(i, j) for i, j in posed.pairs if inside[i] != inside[j]]
    poses = settle(posed, inside, posed.poses, across)
    before = a_point(posed.pairs_at(across))
    after = a_point(posed.pairs_at(across, 1.0, poses))
    k = int(np.argmax(inside))
    return _displacement(posed, arc(inside), compose(poses[k], inverse(posed.poses[k])), after - before)


def _displacement(posed: PosedViews, where: Arc, move: Array, gain: float) -> Displacement:
    """A motion (4, 4) of an arc; one that its views do not resolve gains nothing that counts."""
    view, T = posed.views[where.first], posed.poses[where.first]
    seen = apply(T, view.points)
    moved = np.sqrt(((apply(move, seen) - seen) ** 2).sum(axis=1).mean())
    shift = float(np.linalg.norm(apply(move, posed.centre) - posed.centre))
    counted = gain if moved > view.resolution else min(gain, 0.0)
    return Displacement(where, rotation_angle(move[:3, :3]), shift, counted, move)
