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

"""Is the rotation observable: would the key frames agree as well if some of them were turned?

Three questions, answered in nats a point. Turned about its weakest axis, a body of revolution looks the
same, and so does a spring or a thread, screwed along its own (:func:`least_turning_loss`). A part that
slipped far along a round flank would agree better turned back (:func:`worst_turned_arc`). And where submaps
were joined by appearance alone, a part of the scan may show another of the target's equal sides
(:func:`least_joining_loss`).
"""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, exp_so3, log_so3, rotation_angle
from debris_scanner.mapping.bridging import FreeMotion
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.consistency import (
    ELSEWHERE,
    FEWEST,
    Displacement,
    a_point,
    across_ends,
    agreement_across,
    arc,
    arcs,
    pairs_across,
    settle,
)
from debris_scanner.modelling.symmetry import SHARE, turns_onto_itself
from debris_scanner.registration.projective import marginal_rotation
from debris_scanner.sensing.views import View

TURNS_DEG = (10.0, -10.0, 30.0, -30.0, 45.0, -45.0)
ORDERS = (2, 3, 4, 5, 6, 8, 12)  # of rotational symmetry
SETTLED = 3  # of the turned parts: the best ones
ROUNDS = 2  # of settling
AXIS_POINTS = 200  # of a view
LINE_STEP = 0.1  # of the extent: first step of the search for the axis of a turn
LINE_TRIALS, LINE_PAIRS = 24, 12  # of that search
SEEN = 3  # points of a cell of the surface: one alone may be noise, or a flying pixel
MOSTLY = 0.9  # share of the points in such cells, which are as small as that allows
COARSEST = 0.1  # of the extent: larger cells hide the shape
ARCS = 4  # that are turned: those whose pairs say least about their rotation


def least_turning_loss(posed: PosedViews, inside: NDArray[np.bool_] | None = None) -> tuple[float, Array]:
    """Loss of turning a part of the scan about the axis of least information, and that axis (3,).

    The least over turns of 10 to 45 degrees, in place and along the axis; infinite if the parts have nothing
    in common.

    Args:
        posed: key frames.
        inside: (n,), the part; None: the later half.
    """
    n = len(posed.views)
    if not posed.pairs:
        return np.inf, np.array([0.0, 0.0, 1.0])
    inside = np.arange(n) >= n // 2 if inside is None else inside
    axis, about = _weakest_line(posed, inside)
    _, screw_axis, beside, pitch = _weakest(_information(posed))
    turns = [turned_about(axis, turn, about) for turn in np.radians(TURNS_DEG)]
    turns += [turned_about(screw_axis, turn, beside, pitch) for turn in np.radians(TURNS_DEG)]
    return _least_loss(posed, inside, turns)[0], axis


def worst_turned_arc(posed: PosedViews) -> Displacement | None:
    """The arc that gains most by a turn of 10 to 45 degrees about the axis that its pairs say least about.

    None where no arc has enough in common with the rest.
    """
    inside = arcs(len(posed.views))
    terms = posed.pairs_at(posed.pairs)
    if not terms:
        return None
    across = np.abs(across_ends(inside, posed.pairs))
    points = across @ np.array([t.points for t in terms])
    information = (across @ np.array([t.H.ravel() for t in terms])).reshape(-1, 6, 6)
    axes = {k: _weakest(information[k]) for k in np.flatnonzero(points >= FEWEST).tolist()}
    tried = []
    for k in sorted(axes, key=lambda k: axes[k][0] / points[k])[:ARCS]:
        _, axis, about, _ = axes[k]
        turns = [turned_about(axis, turn, about) for turn in np.radians(TURNS_DEG)]
        loss, twist = _least_loss(posed, inside[k], turns)
        turn, shift = (float(np.linalg.norm(part)) for part in (twist[:3], twist[3:]))
        tried.append(Displacement(arc(inside[k]), turn, shift, -loss, posed.moved_pose(twist, np.eye(4))))
    return max(tried, key=lambda d: d.gain, default=None)


def least_joining_loss(posed: PosedViews, inside: NDArray[np.bool_], motion: FreeMotion) -> float:
    """Loss of having joined the views inside (n,) turned by a full turn over 2 to 12 about a main axis.

    The axes are those of what was seen, which may be half of the target. So a turned part settles first,
    wherever that is, but for the place where it is posed. Views from so far aside that none can be compared
    say nothing against a turn that leaves the surface as it is: that costs nothing.

    Args:
        posed: key frames.
        inside: the part.
        motion: of the key frames; where it does not lead, the part cannot be.
    """
    across = pairs_across(posed, inside, 1)
    usual = posed.pairs_at(across)
    if sum(t.points for t in usual) < FEWEST:
        return 0.0  # nothing says how they lie

    def possible(turned: PosedViews) -> bool:
        return moved_elsewhere(posed, turned.poses, inside) and motion.leads(turned.poses, inside)

    def elsewhere(start: PosedViews) -> tuple[float, PosedViews] | None:
        settled = start
        for _ in range(ROUNDS):
            if agreement_across(settled, inside) is None:
                return None
            poses = settle(settled, inside, settled.poses, pairs_across(settled, inside))
            settled = settled.posed(poses)
        there = agreement_across(settled, inside)
        return (there, settled) if there is not None and possible(settled) else None

    for twist in _turns_onto_itself(posed):
        turned = posed.posed(posed.moved(inside, twist, posed.poses))
        if agreement_across(turned, inside) is None and possible(turned):
            return 0.0
    coarse = posed.coarse()
    rough = [elsewhere(coarse.posed(posed.moved(inside, twist, posed.poses))) for twist in _symmetries(posed)]
    best = sorted((r for r in rough if r is not None), key=lambda r: -r[0])[:SETTLED]
    fine = [elsewhere(posed.posed(turned.poses)) for _, turned in best]
    return a_point(usual) - max((f[0] for f in fine if f is not None), default=-np.inf)


def moved_elsewhere(posed: PosedViews, poses: Sequence[Array], inside: NDArray[np.bool_]) -> bool:
    """Whether the views inside (n,) lie at another place, by poses (4, 4), than where they are posed."""
    first = int(np.argmax(inside))
    return rotation_angle(poses[first][:3, :3] @ posed.poses[first][:3, :3].T) > ELSEWHERE


def weakest_axis(posed: PosedViews) -> tuple[Array, Array]:
    """The axis (3,) about which the views say least of a turn, and a point (3,) on it, about the centre."""
    _, axis, about, _ = _weakest(_information(posed))
    return axis, about


def _information(posed: PosedViews) -> Array:
    return np.asarray(sum((pair.H for pair in posed.pairs_at(posed.pairs)), np.zeros((6, 6))))


def _weakest_line(posed: PosedViews, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The weakest axis (3,), and where it lies, a point (3,) about the centre, for turns to cost least.

    Outlines tell where a round body's axis is, and have no slope that the information could hold. Beside its
    axis such a body seems to show its turn. So the line is moved sideways until the loss itself is least.
    """
    axis, about = weakest_axis(posed)
    few, turn = posed.coarse(), np.radians(min(np.abs(TURNS_DEG)))
    across = pairs_across(few, inside, 1)
    some = across[:: max(1, len(across) // LINE_PAIRS)]
    sideways = posed.beam.extent * np.linalg.svd(axis[None])[2][1:]

    def cost(shift: Array) -> float:
        line = about + shift @ sideways
        return sum(_loss(few, inside, turned_about(axis, angle, line), some) for angle in (turn, -turn))

    start = np.vstack([np.zeros(2), LINE_STEP * np.eye(2)])
    if not np.isfinite([cost(shift) for shift in start]).all():
        return axis, about  # too little in common to tell
    options = {'initial_simplex': start, 'maxfev': LINE_TRIALS}
    best = scipy.optimize.minimize(cost, start[0], method='Nelder-Mead', options=options).x
    return axis, about + best @ sideways


def turned_about(axis: Array, angle: float, about: Array, pitch: float = 0.0) -> Array:
    """The twist (6,) by an angle, rad, about a line through a point, both (3,), and along it: m a radian."""
    R = exp_so3(axis * angle)
    shift = about - R @ about + pitch * angle * axis
    # exp_se3 takes the translation as it is
    return np.concatenate([axis * angle, shift])


def _weakest(H: Array) -> tuple[float, Array, Array, float]:
    """Least information on a rotation, its axis (3,), a point (3,) on it, and the pitch, m a radian.

    Args:
        H: information (6, 6) on a twist about the centre.
    """
    rotation, shift = marginal_rotation(H, np.zeros(3))
    values, vectors = np.linalg.eigh(rotation)
    axis = vectors[:, 0]
    # a cylinder that turns about a line beside its axis moves sideways, which is visible
    return float(values[0]), axis, np.cross(axis, shift @ axis), float(axis @ shift @ axis)


def _least_loss(posed: PosedViews, inside: NDArray[np.bool_], twists: Sequence[Array]) -> tuple[float, Array]:
    """The least loss of moving the views inside, and its twist (6,): all points are asked of the best."""
    few = posed.coarse()
    twist = min(twists, key=lambda twist: _loss(few, inside, twist))
    return _loss(posed, inside, twist), twist


def _loss(
    posed: PosedViews,
    inside: NDArray[np.bool_],
    twist: Array,
    across: Sequence[tuple[int, int]] | None = None,
) -> float:
    """What the pairs across, or some of them, lose if the views inside are moved."""
    across = pairs_across(posed, inside, 1) if across is None else across
    asked = inside & np.isin(np.arange(len(inside)), across)
    poses = posed.moved(asked, twist, posed.poses)
    before = posed.pairs_at(across)
    after = posed.pairs_at(across, 1.0, poses)
    if min(sum(t.points for t in before), sum(t.points for t in after)) < FEWEST:
        return np.inf
    return a_point(before) - a_point(after)


def _turns_onto_itself(posed: PosedViews) -> Iterator[Array]:
    """Twists about the centre that leave the surface as it is, as far as views saw it repeatedly."""
    points = np.concatenate([apply(T, v.points) for v, T in _each(posed)])
    normals = np.concatenate([v.normals @ T[:3, :3].T for v, T in _each(posed)])
    spacing = float(np.median([v.resolution for v in posed.views]))
    shared = 0.0
    while shared < MOSTLY * len(points):
        spacing *= 2.0
        if spacing > COARSEST * posed.beam.extent:
            return
        # the two faces of a thin plate lie in one cell
        cells = np.column_stack([np.floor(points / spacing), normals > 0])
        _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        shared = count[count >= SEEN].sum()
    sums = np.zeros((len(count), 6))
    np.add.at(sums, cell.ravel(), np.column_stack([points, normals]))
    surface, directions = np.split(sums[count >= SEEN] / count[count >= SEEN, None], 2, axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)  # of one sign each: they do not cancel
    for _, T, share in turns_onto_itself(surface.astype(np.float32), directions.astype(np.float32), spacing):
        if share >= SHARE:
            # exp_se3 takes the translation as it is
            yield np.concatenate([log_so3(T[:3, :3]), apply(T, posed.centre) - posed.centre])


def _each(posed: PosedViews) -> Iterator[tuple[View, Array]]:
    return zip(posed.views, posed.poses, strict=True)


def _symmetries(posed: PosedViews) -> Iterator[Array]:
    """Twists about the centre, by a full turn over each order about each principal axis of what was seen."""
    seen = np.concatenate(
        [apply(T, v.points[:: max(1, len(v.points) // AXIS_POINTS)].astype(float)) for v, T in _each(posed)]
    )
    middle = seen.mean(axis=0)
    axes = np.linalg.eigh(np.cov(seen.T))[1]
    for order in ORDERS:
        for axis in axes.T:
            yield turned_about(axis, 2 * np.pi / order, middle - posed.centre)
