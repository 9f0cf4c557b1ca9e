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

Two questions. Turned a little about its weakest axis, a body of revolution looks the same
(:func:`least_turning_loss`). And where submaps were joined by appearance alone, a part of the scan may show
another of the target's equal sides (:func:`least_joining_loss`). Losses are in nats a point.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, rotation_angle
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.consistency import FEWEST, a_point, settle
from debris_scanner.registration.projective import marginal_rotation

TURNS_DEG = (10.0, -10.0, 30.0, -30.0, 45.0, -45.0)
ORDERS = (2, 3, 4, 5, 6, 8, 12)  # of rotational symmetry
WIDE = 3.0  # factor on the noise while turned parts are compared
SETTLED = 3  # of the turned parts: the best ones
SLID = np.radians(10.0)  # a part that settles further off has gone back to where it came from
AXIS_POINTS = 200  # of a view


def least_turning_loss(posed: PosedViews) -> tuple[float, Array]:
    """Loss of turning half of the scan about the axis of least information, and that axis (3,).

    The least over turns of 10 to 45 degrees; infinite if the halves have nothing in common.
    """
    n = len(posed.views)
    terms = [posed.pair(i, j) for i, j in posed.pairs]
    if not terms:
        return np.inf, np.array([0.0, 0.0, 1.0])
    # H is about the centre already
    rotation, shift = marginal_rotation(sum((t.H for t in terms), np.zeros((6, 6))), np.zeros(3))
    axis = np.linalg.eigh(rotation)[1][:, 0]
    # a cylinder that turns about a line beside its axis moves sideways, which is visible
    about = np.cross(axis, shift @ axis)
    inside = np.arange(n) >= n // 2
    return min(_loss(posed, inside, _twist(axis, np.radians(turn), about)) for turn in TURNS_DEG), axis


def least_joining_loss(posed: PosedViews, inside: NDArray[np.bool_]) -> float:
    """Loss of having joined the views inside (n,) turned by a full turn over 2 to 12 about a main axis."""
    across = [(i, j) for i, j in posed.pairs if inside[i] != inside[j]]
    usual = [posed.pair(i, j) for i, j in across]
    if sum(t.points for t in usual) < FEWEST:
        return 0.0  # nothing says how they lie
    here = a_point(usual)
    tried = []
    for twist in _symmetries(posed):
        turned = posed.posed(posed.moved(inside, twist, posed.poses))
        pairs = [(i, j) for i, j in turned.pairs if inside[i] != inside[j] and j - i > 1]
        terms = [turned.pair(i, j, WIDE) for i, j in pairs]
        if sum(t.points for t in terms) >= FEWEST:
            tried.append((a_point(terms), turned, pairs))
    tried.sort(key=lambda found: -found[0])
    losses = [np.inf]
    first = int(np.argmax(inside))
    for _, turned, pairs in tried[:SETTLED]:
        poses = settle(turned, inside, turned.poses, pairs)
        back = compose(poses[first], inverse(turned.poses[first]))
        if rotation_angle(back[:3, :3]) > SLID:
            continue
        losses.append(here - a_point([turned.pair(i, j, 1.0, poses) for i, j in pairs]))
    return min(losses)


def _loss(posed: PosedViews, inside: NDArray[np.bool_], twist: Array) -> float:
    """What the pairs across lose if the views inside are moved."""
    across = [(i, j) for i, j in posed.pairs if inside[i] != inside[j]]
    poses = posed.moved(inside, twist, posed.poses)
    before = [posed.pair(i, j) for i, j in across]
    after = [posed.pair(i, j, 1.0, poses) for i, j in across]
    if min(sum(t.points for t in before), sum(t.points for t in after)) < FEWEST:
        return np.inf
    return a_point(before) - a_point(after)


def _symmetries(posed: PosedViews) -> Iterator[Array]:
    """Twists about the centre, by a full turn over each order about each principal axis of what was seen."""
    seen = np.concatenate(
        [
            apply(T, v.points[:: max(1, len(v.points) // AXIS_POINTS)].astype(float))
            for v, T in zip(posed.views, posed.poses, strict=True)
        ]
    )
    middle = seen.mean(axis=0)
    axes = np.linalg.eigh(np.cov(seen.T))[1]
    for order in ORDERS:
        for axis in axes.T:
            yield _twist(axis, 2 * np.pi / order, middle - posed.centre)


def _twist(axis: Array, angle: float, about: Array) -> Array:
    """The twist (6,) that turns by an angle about a line through a point."""
    R = exp_so3(axis * angle)
    shift = about - R @ about
    # exp_se3 takes the translation as it is
    return np.concatenate([axis * angle, shift])
