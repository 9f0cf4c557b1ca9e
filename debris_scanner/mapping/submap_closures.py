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

"""Closures between submaps: nothing is known of their poses, so likeness proposes; two that agree decide."""

from dataclasses import dataclass, field

import numpy as np

from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.projective import RegistrationStats, linearise_pair, register
from debris_scanner.sensing.views import View

ROLLS = 12  # attitudes about the line of sight that a view is registered from
DISTINCT = np.radians(8.0)  # registered attitudes further apart than this are rivals
MARGIN = 0.05  # of the overlap, by which the best must beat them

# A face has its like on many targets, and nothing else speaks for these: they must agree beyond doubt.
OVERLAP = 0.92
RMS = 0.0021  # m
CONTRADICTING = 0.004
OUTSIDE = 0.03

SAME_TURN, SAME_PLACE = np.radians(4.0), 0.012  # rad, m: two closures that agree on where a submap is
APART = np.radians(8.0)  # and show two sides
NEARBY = np.radians(20.0)  # key frames of two submaps that then look from so near must agree
LEAST_NEARBY = 3  # pairs of them
NEARBY_OVERLAP = 0.8  # median
NEARBY_FREE_SPACE_VIOLATION = 0.006  # 90th percentile
GATE = 0.012  # m


@dataclass(frozen=True)
class Proposal:
    """A key frame that shows a face of another submap, and where that puts the submap."""

    submap: int
    from_index: int
    to_index: int
    probability: float
    T_from_to: Array  # (4, 4)
    T_active_submap: Array  # (4, 4)


@dataclass
class Proposals:
    """Those of the active submap so far; two that agree, seen from two sides, join a submap to it."""

    active: int = 0
    _pending: list[Proposal] = field(default_factory=list)

    def second(self, active: int, proposal: Proposal, turns: list[Array], centre: Array) -> Proposal | None:
        """An earlier proposal that agrees with a new one, which is kept.

        Args:
            active: the submap that is joined to.
            proposal: the new one.
            turns: attitudes R_target_sensor (3, 3) of all key frames.
            centre: of the target (3,), active target frame.
        """
        if active != self.active:
            self.active, self._pending = active, []
        new = proposal.T_active_submap
        agreeing = [
            p
            for p in self._pending
            if p.submap == proposal.submap
            and rotation_angle(p.T_active_submap[:3, :3] @ new[:3, :3].T) < SAME_TURN
            and np.linalg.norm(_place(p.T_active_submap, new, centre)) < SAME_PLACE
            and rotation_angle(turns[p.to_index] @ turns[proposal.to_index].T) > APART
        ]
        self._pending.append(proposal)
        return agreeing[0] if agreeing else None


def find_turn(view: View, earlier: View) -> tuple[Array | None, str]:
    """Pose T_earlier_view (4, 4) of a view, whatever its roll, or None if in doubt; and what decided."""
    centre, seen = earlier.centroid, view.centroid
    sight = seen / np.linalg.norm(seen)
    fits: list[tuple[float, Array, RegistrationStats]] = []
    for roll in np.arange(ROLLS) * (2 * np.pi / ROLLS):
        R = exp_so3(roll * sight)
        found = register(view, transform(R, centre - R @ seen), earlier, np.eye(4))
        if found is not None:
            fits.append((found[1].stats.overlap, found[0], found[1].stats))
    if not fits:
        return None, 'the views do not overlap'
    overlap, T, a = max(fits, key=lambda f: f[0])
    violation = a.free_space_violation_ratio
    numbers = f'overlap {a.overlap:.3g}, residual_mm {a.rms * 1e3:.3g}, free_space {violation:.3g}'
    if (
        overlap < OVERLAP
        or a.rms > RMS
        or violation > CONTRADICTING
        or a.silhouette_violation_ratio > OUTSIDE
    ):
        return None, f'another submap: not beyond doubt: {numbers}'
    if any(o > overlap - MARGIN and rotation_angle(F[:3, :3] @ T[:3, :3].T) > DISTINCT for o, F, _ in fits):
        return None, f'another submap: another attitude fits as well: {numbers}'
    return T, f'another submap: {numbers}'


def agree(keyframes: KeyFrameSet, submap: int, T_active_submap: Array) -> str:
    """Why a submap's key frames and the active ones contradict each other there; empty if they agree."""
    active = keyframes.active
    others = [k for k, f in enumerate(keyframes.frames) if f.submap == submap]
    centre = keyframes.centre
    edge_stats = []
    for k in others:
        T = compose(T_active_submap, keyframes.frames[k].T_target_sensor)
        angles = keyframes.view_angles(T, centre)
        for m in active:
            if angles[m] < NEARBY:
                T_m = keyframes.frames[m].T_target_sensor
                lin = linearise_pair(keyframes.views[k], T, keyframes.views[m], T_m, GATE)
                edge_stats.append(lin.stats)
    if len(edge_stats) < LEAST_NEARBY:
        return f'no more than {len(edge_stats)} pairs look from nearby'
    overlap = float(np.median([a.overlap for a in edge_stats]))
    contradicting = float(np.percentile([a.free_space_violation_ratio for a in edge_stats], 90))
    if overlap < NEARBY_OVERLAP or contradicting > NEARBY_FREE_SPACE_VIOLATION:
        return f'of all pairs overlap {overlap:.3g}, contradicting {contradicting:.3g}'
    return ''


def _place(T_a: Array, T_b: Array, centre: Array) -> Array:
    """How far apart (3,) two placements of a submap put the target's centre."""
    return apply(T_a, apply(inverse(T_b), centre)) - centre
