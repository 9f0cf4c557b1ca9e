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

"""Poses climbed to where their views agree best, along the turns that the views say little about.

Relaxation weighs steps from one key frame to the next against views of the same side at other times, and sets
those aside that contradict it. Where each step falls short by a little, as before a nearly round target, all
of them together hold a scan in a place that explains its views worse than the truth does. From there no small
step leads away, but a turn that grows along the whole scan does.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from debris_scanner.core.geometry import Array, log_so3, rotation_angle
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.ambiguity import weakest_axis
from debris_scanner.modelling.consistency import ELSEWHERE, SOME, agreement

LINE = np.radians([-40.0, -32.0, -24.0, -16.0, -8.0, 8.0, 16.0, 24.0, 32.0, 40.0])  # of the last view
STEPS = np.radians([8.0, 4.0, 2.0])  # of the parts of a scan, one after the other
PARTS = 4  # of a scan; within each the turn grows evenly
ROUNDS = 2  # over the axes
LEAST_GAIN = 0.01  # nats a point
ALONG = 0.9  # cosine, of two axes that are one


def climbed(posed: PosedViews) -> list[Array] | None:
    """Poses (4, 4) of the views where they agree better by a turn that grows along the scan; None if nowhere.

    The axes are the motion's own and the one that the views say least of a turn about.
    """
    first = best = agreement(posed.coarse(), SOME)
    poses = posed.poses
    for _ in range(ROUNDS):
        before = best
        for axis in main_axes(posed.posed(poses)):
            best, poses = _climb(posed.coarse().posed(poses), axis)
        if best < before + LEAST_GAIN:
            break
    return list(poses) if best > first + LEAST_GAIN else None


def main_axes(posed: PosedViews) -> list[Array]:
    """The axis (3,) of the motion, and the one that the views say least of a turn about, if it is another."""
    own, weakest = np.linalg.svd(_turns(posed.poses))[2][0], weakest_axis(posed)[0]
    return [own, weakest] if abs(own @ weakest) < ALONG else [own]


def travelled(poses: Sequence[Array]) -> Array:
    """How far the target has turned, rad, until each pose (n,): the way there, whatever its directions."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(_turns(poses), axis=1))])


def turned_along(posed: PosedViews, by: Array, axis: Array) -> list[Array]:
    """The poses (4, 4), turned by angles (n,), rad, about an axis (3,)."""
    twists = [np.concatenate([turn * axis, np.zeros(3)]) for turn in by]
    return [posed.moved_pose(twist, T) for twist, T in zip(twists, posed.poses, strict=True)]


def moved_far(poses: Sequence[Array], others: Sequence[Array]) -> bool:
    """Whether views lie elsewhere, among themselves, by other poses (4, 4)."""
    apart = [a[:3, :3] @ b[:3, :3].T for a, b in zip(poses, others, strict=True)]
    return any(rotation_angle(apart[0].T @ R) > ELSEWHERE for R in apart)


def _climb(posed: PosedViews, axis: Array) -> tuple[float, list[Array]]:
    """The agreement that turns about an axis (3,) lead to, nats a point, and the poses (4, 4) there."""
    path = travelled(posed.poses)
    share, ends = path / max(path[-1], 1e-9), np.linspace(0.0, 1.0, PARTS + 1)

    def turned(end: Array) -> list[Array]:
        return turned_along(posed, np.interp(share, ends, np.concatenate([[0.0], end])), axis)

    def agrees(end: Array) -> float:
        return agreement(posed.posed(turned(end)), SOME)

    at = np.zeros(PARTS)
    best, at = max(
        [(agreement(posed, SOME), at), *((agrees(turn * ends[1:]), turn * ends[1:]) for turn in LINE)],
        key=lambda found: found[0],
    )
    for step in STEPS:
        for k in range(PARTS):
            for turn in (step, -step):
                further = turn * (np.arange(PARTS) >= k)  # what comes after a part turns along with it
                while (found := agrees(at + further)) > best + LEAST_GAIN:
                    best, at = found, at + further
    return best, turned(at)


def _turns(poses: Sequence[Array]) -> Array:
    """Rotation vectors (n - 1, 3) from each pose to the next, rad, target frame."""
    return np.array([log_so3(b[:3, :3] @ a[:3, :3].T) for a, b in pairwise(poses)])
