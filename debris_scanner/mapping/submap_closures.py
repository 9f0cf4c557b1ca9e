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

"""Closures between submaps: of unknown relative pose, so similarity proposes and two proposals must agree."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import compared
from debris_scanner.mapping.bridging import Bridge, FreeMotion
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.projective import RegistrationStats, linearise_pair, register
from debris_scanner.sensing.views import View

ROLLS = 12  # initial attitudes about the line of sight for the registration
DISTINCT = np.radians(8.0)  # registered attitudes further apart are competing hypotheses
MARGIN = 0.05  # of the overlap, by which the best must exceed the others

# Strict gate: many targets have similar faces, and appearance is the only cue.
MIN_OVERLAP = 0.92
MAX_RMS = 1.4  # px
MAX_FREE_SPACE_VIOLATION = 0.004
MAX_SILHOUETTE_VIOLATION = 0.03

# Two proposals that agree on a submap's pose, seen from two sides.
SAME_ROTATION, SAME_POSITION = np.radians(4.0), 8.0  # rad, px
MIN_APART = np.radians(8.0)

# Key frames of the two submaps that then look from similar directions must fit.
NEARBY = np.radians(20.0)
MIN_NEARBY_PAIRS = 3
MIN_NEARBY_OVERLAP = 0.8  # median
MAX_NEARBY_FREE_SPACE_VIOLATION = 0.006  # 90th percentile; or, where it is more,
USUAL_FACTOR = 2.0  # times that of pairs within the active submap
GATE = 8.0  # px


@dataclass(frozen=True)
class Proposal:
    """A key frame that shows a face of another submap, and the pose of that submap it implies."""

    submap: int
    from_index: int
    to_index: int
    probability: float
    T_from_to: Array  # (4, 4)
    T_active_submap: Array  # (4, 4)


@dataclass(frozen=True)
class RollFit:
    """Best fit of a view at any roll."""

    T_earlier_view: Array | None  # (4, 4), registered; None where nothing overlaps
    certain: bool  # beyond doubt, and the only one
    why: str  # the numbers that decided


@dataclass
class Proposals:
    """Proposals of the active submap so far; two that agree, seen from two sides, merge a submap with it."""

    active: int = 0
    _pending: list[Proposal] = field(default_factory=list)

    def match(
        self, active: int, proposal: Proposal, rotations: list[Array], centre: Array, footprint: float
    ) -> Proposal | None:
        """An earlier proposal that agrees with a new one, or None; the new one is kept.

        Args:
            active: the submap that others are merged with.
            proposal: the new one.
            rotations: attitudes R_target_sensor (3, 3) of all key frames.
            centre: of the target (3,), active target frame.
            footprint: m, of a pixel at the target.
        """
        if active != self.active:
            self.active, self._pending = active, []
        new = proposal.T_active_submap
        agreeing = [
            p
            for p in self._pending
            if p.submap == proposal.submap
            and rotation_angle(p.T_active_submap[:3, :3] @ new[:3, :3].T) < SAME_ROTATION
            and np.linalg.norm(_displacement(p.T_active_submap, new, centre)) < SAME_POSITION * footprint
            and rotation_angle(rotations[p.to_index] @ rotations[proposal.to_index].T) > MIN_APART
        ]
        self._pending.append(proposal)
        return agreeing[0] if agreeing else None


def register_at_any_roll(view: View, earlier: View) -> RollFit:
    """Register a view to an earlier one from many rolls about the line of sight."""
    centre, seen = earlier.centroid, view.centroid
    sight = seen / np.linalg.norm(seen)
    fits: list[tuple[float, Array, RegistrationStats]] = []
    for roll in np.arange(ROLLS) * (2 * np.pi / ROLLS):
        R = exp_so3(roll * sight)
        found = register(view, transform(R, centre - R @ seen), earlier, np.eye(4))
        if found is not None:
            fits.append((found[1].stats.overlap, found[0], found[1].stats))
    if not fits:
        return RollFit(None, False, 'the views do not overlap')
    overlap, T, a = max(fits, key=lambda f: f[0])
    violation = a.free_space_violation_ratio
    numbers = f'overlap {a.overlap:.3g}, residual_px {a.rms:.3g}, free_space {violation:.3g}'
    if (
        overlap < MIN_OVERLAP
        or a.rms > MAX_RMS
        or violation > MAX_FREE_SPACE_VIOLATION
        or a.silhouette_violation_ratio > MAX_SILHOUETTE_VIOLATION
    ):
        return RollFit(T, False, f'another submap: not beyond doubt: {numbers}')
    if any(o > overlap - MARGIN and rotation_angle(F[:3, :3] @ T[:3, :3].T) > DISTINCT for o, F, _ in fits):
        return RollFit(T, False, f'another submap: another attitude fits as well: {numbers}')
    return RollFit(T, True, f'another submap: {numbers}')


def contradiction(keyframes: KeyFrameSet, submap: int, T_active_submap: Array) -> str:
    """Why a submap at this pose contradicts the active key frames, or the motion; empty if it agrees."""
    if bridge := _unlikely_bridge(keyframes, submap, T_active_submap):
        return str(bridge)
    active = keyframes.active
    centre = keyframes.centre
    others = [k for k, f in enumerate(keyframes.frames) if f.submap == submap]
    moved = [compose(T_active_submap, keyframes.frames[k].T_target_sensor) for k in others]
    across = _pairs_nearby(keyframes, others, moved, active, centre)
    if len(across) < MIN_NEARBY_PAIRS:
        return f'no more than {len(across)} pairs look from nearby'
    # what pairs within the active submap show is this sensor's noise and this target's own occlusion
    at_home = [keyframes.frames[k].T_target_sensor for k in active]
    usual = _pairs_nearby(keyframes, active, at_home, active, centre)
    overlap, contradicting = _typical(across)
    usual_overlap, usual_contradicting = _typical(usual) if usual else (MIN_NEARBY_OVERLAP, 0.0)
    bound = max(MAX_NEARBY_FREE_SPACE_VIOLATION, USUAL_FACTOR * usual_contradicting)
    if overlap < min(MIN_NEARBY_OVERLAP, usual_overlap) or contradicting > bound:
        return f'of all pairs overlap {overlap:.3g}, contradicting {compared(contradicting, ">", bound)}'
    return ''


def _unlikely_bridge(keyframes: KeyFrameSet, submap: int, T_active_submap: Array) -> Bridge | None:
    """A stretch out of sight over which the target cannot have turned as the submap is posed; or None."""
    active = keyframes.active
    members = sorted([*active, *(k for k, f in enumerate(keyframes.frames) if f.submap == submap)])
    frames = [keyframes.frames[k] for k in members]
    there = {submap: T_active_submap}
    poses = [compose(there.get(f.submap, np.eye(4)), f.T_target_sensor) for f in frames]
    linked = [f.linked for f in frames]
    motion = FreeMotion([f.stamp_ns for f in frames], linked, followed=linked)
    bridge = motion.worst_bridge(poses, [f.submap for f in frames])
    return None if bridge is None or bridge.leads_here else bridge


def _pairs_nearby(
    keyframes: KeyFrameSet,
    members: Sequence[int],
    poses: Sequence[Array],
    active: Sequence[int],
    centre: Array,
) -> list[RegistrationStats]:
    """How key frames, posed by T_target_view, agree with active ones that look from similar directions."""
    stats = []
    for k, T in zip(members, poses, strict=True):
        angles = keyframes.view_angles(T, centre)
        for m in active:
            if m != k and angles[m] < NEARBY:
                T_m = keyframes.frames[m].T_target_sensor
                stats.append(linearise_pair(keyframes.views[k], T, keyframes.views[m], T_m, GATE).stats)
    return stats


def _typical(stats: Sequence[RegistrationStats]) -> tuple[float, float]:
    """Median overlap and the 90th percentile of the free-space violation."""
    overlap = float(np.median([a.overlap for a in stats]))
    return overlap, float(np.percentile([a.free_space_violation_ratio for a in stats], 90))


def _displacement(T_a: Array, T_b: Array, centre: Array) -> Array:
    """Displacement (3,) of the target's centre between two poses of a submap."""
    return apply(T_a, apply(inverse(T_b), centre)) - centre
