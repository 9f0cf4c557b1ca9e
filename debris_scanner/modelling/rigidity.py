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

"""The test of rigidity: does a side of the target look later as it looked before?

Neighbouring views of one side disagree by what the sensor does, and by nothing else. Views of the same side
from other times, at least half a turn later, must not disagree by more: each pair is compared at the pose
that suits it best, so that an error of the poses does not count. Where they do, in more pairs than chance
explains, the target has bent, grown, lost or gained a part, or been exchanged for another.

The sensor need not be known: its neighbouring pairs are the measure of the others (the signed rank test of
Wilcoxon 1945).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, inverse, solve_informed
from debris_scanner.core.results import Check, at_most
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.registration.likelihood import MET, PairLikelihood
from debris_scanner.sensing.sensor_model import difference

SAME_SIDE = np.radians(20.0)  # of rotation between two views that are compared
PARTNERS = 3  # of each view, of either kind
NEIGHBOURS, OTHER_TIMES = range(2)
SAME_TIME, OTHER_TIME = np.radians(40.0), np.pi  # of rotation that the target has gone through meanwhile
FEWEST_PAIRS = 30  # of either kind; fewer tell of some moments alone
FEWEST_POINTS = 200  # that both views of a pair show
CHANCE = 5.0  # standard deviations of the ranks: beyond, it is none
LEAST_CHANGE = 0.04  # nats a point, of the median; less changes no model
SHOWN = 10  # pairs that disagree most, in which the change is looked for
REACH_PX = 40.0  # in depth: how far a part that was not there may stand out
BEYOND_NOISE = 4.0  # standard deviations of a pixel's difference
CELL_PX = 10.0  # side of the cells in which what has changed is counted


@dataclass(frozen=True)
class Change:
    """What has changed between views of one side."""

    loss: float  # nats a point, by which views of other times disagree more than neighbours do
    deviations: float  # of the ranks from what chance gives, in standard deviations
    pairs: int  # of views from other times
    before_ns: int  # stamps of the two views that disagree most
    after_ns: int
    at: Array  # (3,), target frame, where most has changed
    by: float  # m, how far the surface there stands out

    @property
    def check(self) -> Check:
        """The number that decided."""
        return at_most('deviations_of_chance', self.deviations, CHANCE)

    @property
    def words(self) -> str:
        """What has changed, for people."""
        x, y, z = self.at * 1e3
        before_s, after_s = self.before_ns * 1e-9, self.after_ns * 1e-9
        return (
            f'{self.pairs} pairs of views of one side from other times contradict each other by '
            f'{self.loss:.2f} nats a point more than neighbours do, most between '
            f'{before_s:.2f} and {after_s:.2f} s, by {self.by * 1e3:.1f} mm at ({x:.0f}, {y:.0f}, {z:.0f}) mm'
        )


def change_over_time(posed: PosedViews) -> Change | None:
    """What has changed on the target; None if nothing shows, or no side was seen at two times.

    Args:
        posed: key frames in order of time, at their final poses.
    """
    pairs = list(_pairs(posed))
    compared = posed.pairs_at([(i, j) for i, j, *_ in pairs])
    rows = [
        (*pair, loss) for pair, both in zip(pairs, compared, strict=True) if np.isfinite(loss := _loss(both))
    ]
    if not rows:
        return None
    i, j, kind, turn, loss = np.array(rows).T
    near, far = kind == NEIGHBOURS, kind == OTHER_TIMES
    if near.sum() < FEWEST_PAIRS:
        return None
    # the further apart two views look from, the less they agree
    beyond = loss - np.polyval(np.polyfit(turn[near], loss[near], 1), turn)
    first, second = i.astype(int), j.astype(int)
    # some sides show less well than others: a pair is compared with the neighbours of its own two views
    usual = _means(len(posed.views), first[near], second[near], beyond[near])
    more = beyond - 0.5 * (usual[first] + usual[second])
    far &= np.isfinite(more) & (turn <= turn[near].max())  # beyond, how well they should agree is not known
    if far.sum() < FEWEST_PAIRS:
        return None
    change, deviations = float(np.median(more[far])), signed_rank(more[far])
    if deviations <= CHANCE or change <= LEAST_CHANGE:
        return None
    worst = np.flatnonzero(far)[np.argsort(-more[far])[:SHOWN]]
    chosen = [(int(first[k]), int(second[k])) for k in worst]
    at, by = _where(posed, chosen)
    stamps = [posed.views[k].frame.stamp_ns for k in chosen[0]]
    return Change(change, deviations, int(far.sum()), stamps[0], stamps[1], at, by)


def signed_rank(values: NDArray[np.float64]) -> float:
    """By how many standard deviations the ranks of positive values (n,) outweigh those of negative ones."""
    n = len(values)
    rank = np.empty(n)
    rank[np.argsort(np.abs(values), kind='stable')] = np.arange(1, n + 1)
    above = float(rank[values > 0].sum()) - n * (n + 1) / 4
    return above / float(np.sqrt(n * (n + 1) * (2 * n + 1) / 24))


def _means(
    count: int, first: NDArray[np.intp], second: NDArray[np.intp], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean (count,) of the values of all pairs that a view is in; NaN of a view in none."""
    both = np.concatenate([first, second])
    pairs = np.bincount(both, minlength=count)
    total = np.bincount(both, np.tile(values, 2), minlength=count)
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def _pairs(posed: PosedViews) -> Iterator[tuple[int, int, int, float]]:
    """Pairs of views that look at one side in one way up, their kind, and the angle between them, rad.

    The same way up, for what a sensor does wrong in its image turns with the image: views of a tumble that
    are rolled against each other disagree by it. Of each view a few pairs of either kind.
    """
    R = np.array([T[:3, :3] for T in posed.poses])
    turns = np.arccos(np.clip((np.einsum('aij,bij->ab', R, R) - 1) / 2, -1, 1))
    travelled = np.concatenate([[0.0], np.cumsum(np.diagonal(turns, 1))])
    for i in range(len(R)):
        since, turn, least = travelled[i + 1 :] - travelled[i], turns[i, i + 1 :], SAME_SIDE
        for kind, there in ((NEIGHBOURS, since < SAME_TIME), (OTHER_TIMES, since > OTHER_TIME)):
            # none that is turned by less than the view's neighbours, for the same reason
            found = np.flatnonzero(there & (turn < SAME_SIDE) & ((kind == NEIGHBOURS) | (turn >= least)))
            chosen = found[np.argsort(turn[found], kind='stable')[:PARTNERS]]
            least = min([least, *turn[chosen]])
            yield from ((i, i + 1 + int(j), kind, float(turn[j])) for j in chosen)


def _loss(pair: PairLikelihood) -> float:
    """Of what both views show, nats a point, at the pose that suits the pair; NaN for too few points."""
    if pair.numbers[MET] < FEWEST_POINTS:
        return np.nan
    gain = 0.5 * float(pair.g @ solve_informed(pair.H, pair.g))
    return -(float(pair.nats[MET]) + gain) / float(pair.numbers[MET])


def _where(posed: PosedViews, pairs: Sequence[tuple[int, int]]) -> tuple[Array, float]:
    """Where one view of some pairs shows surface before what the other saw, (3,), and by how much, m."""
    points, standing_out = [np.zeros((0, 3))], [np.zeros(0)]
    bound = BEYOND_NOISE * np.sqrt(2) * posed.beam.sigma
    for a, b in [pair for i, j in pairs for pair in ((i, j), (j, i))]:
        view, other = posed.views[a], posed.views[b]
        T = compose(inverse(posed.poses[b]), posed.poses[a])
        off, _, seen = difference(view, T, other, REACH_PX)
        before = seen & (off < -bound)
        points.append(apply(posed.poses[a], view.frame.camera.back_project(view.frame.depth)[before]))
        standing_out.append(-off[before])
    found, by = np.concatenate(points), np.concatenate(standing_out)
    if not len(found):
        return posed.centre, 0.0
    side = CELL_PX * float(np.median([view.footprint for view in posed.views]))
    _, cell, count = np.unique(np.floor(found / side), axis=0, return_inverse=True, return_counts=True)
    most = cell.ravel() == np.argmax(count)
    return found[most].mean(axis=0), float(np.median(by[most]))
