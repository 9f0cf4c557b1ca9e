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

from dataclasses import dataclass, field

import numpy as np

from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import Check, Checks, at_least, at_most, in_words, passed
from debris_scanner.mapping.bridging import Bridge, FreeMotion
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.likelihood import UsualLoss, mutual_loss
from debris_scanner.registration.projective import MIN_OVERLAP, register
from debris_scanner.sensing.views import View

ROLLS = 12  # initial attitudes about the line of sight for the registration
DISTINCT = np.radians(8.0)  # registered attitudes further apart are competing hypotheses
ORDINARY = 0.75  # of the key frames in a row: so many agree better at most, where a face is known again

# Two proposals that agree on a submap's pose, seen from two sides.
SAME_ROTATION, SAME_POSITION = np.radians(4.0), 8.0  # rad, px
MIN_APART = np.radians(8.0)

NO_OVERLAP, NO_OVERLAP_WORDS = Check('overlap', 0.0, MIN_OVERLAP, False), 'the views do not overlap'
ANOTHER_SUBMAP, JOINS_A_SUBMAP = 'another submap', 'joins a submap'  # in front of the checks

# Key frames of the two submaps that then look from similar directions must fit.
NEARBY = np.radians(20.0)
MIN_NEARBY_PAIRS = 3


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
    why: str  # the checks in words
    checks: Checks


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


def register_at_any_roll(view: View, earlier: View, usual: UsualLoss, max_loss: float) -> RollFit:
    """Register a view to an earlier one from many rolls about the line of sight.

    Appearance is the only cue, and many targets have similar faces. So the best fit must be as good as those
    of key frames in a row, and every other attitude must contradict the views.

    Args:
        view: the newer one.
        earlier: the one of another submap.
        usual: loss of consecutive key frames.
        max_loss: nats a point, by which an attitude must lose more to be contradicted.
    """
    centre, seen = earlier.centroid, view.centroid
    sight = seen / np.linalg.norm(seen)
    fits: list[tuple[float, float, Array]] = []
    for roll in np.arange(ROLLS) * (2 * np.pi / ROLLS):
        R = exp_so3(roll * sight)
        found = register(view, transform(R, centre - R @ seen), earlier, np.eye(4))
        if found is not None:
            T, lin = found
            fits.append((mutual_loss(view, T, earlier, np.eye(4)), lin.stats.overlap, T))
    if not fits:
        return RollFit(None, False, NO_OVERLAP_WORDS, (NO_OVERLAP,))
    best, overlap, T = min(fits, key=lambda f: f[0])
    others = [x for x, _, F in fits if rotation_angle(F[:3, :3] @ T[:3, :3].T) > DISTINCT]
    checks = (
        at_least('overlap', overlap, MIN_OVERLAP),
        at_most('loss_rank', usual.rank(best), ORDINARY),
        at_least('lead_over_other_attitudes', min(others, default=np.inf) - best, max_loss),
        Check('excess_loss', usual.excess(best)),
    )
    return RollFit(T, passed(checks), in_words(checks, ANOTHER_SUBMAP), checks)


def contradiction(
    keyframes: KeyFrameSet, submap: int, T_active_submap: Array, usual: UsualLoss, max_loss: float
) -> Checks:
    """Whether a submap at this pose agrees with the active key frames and the motion: a check each."""
    bridge = _worst_bridge(keyframes, submap, T_active_submap)
    motion: Checks = () if bridge is None else bridge.checks
    if not passed(motion):
        return motion
    views, frames, active = keyframes.views, keyframes.frames, keyframes.active
    excesses = []
    for k, frame in enumerate(frames):
        if frame.submap == submap:
            T = compose(T_active_submap, frame.T_target_sensor)
            angles = keyframes.view_angles(T, keyframes.centre)
            excesses += [
                usual.excess(mutual_loss(views[k], T, views[m], frames[m].T_target_sensor))
                for m in active
                if angles[m] < NEARBY
            ]
    worst = max(excesses, default=np.inf)
    return (
        *motion,
        at_least('nearby_pairs', len(excesses), MIN_NEARBY_PAIRS),
        at_most('worst_pair_excess_loss', worst, max_loss),
    )


def _worst_bridge(keyframes: KeyFrameSet, submap: int, T_active_submap: Array) -> Bridge | None:
    """The stretch out of sight over which the target can least have turned as the submap is posed."""
    active = keyframes.active
    members = sorted([*active, *(k for k, f in enumerate(keyframes.frames) if f.submap == submap)])
    frames = [keyframes.frames[k] for k in members]
    there = {submap: T_active_submap}
    poses = [compose(there.get(f.submap, np.eye(4)), f.T_target_sensor) for f in frames]
    linked = [f.linked for f in frames]
    motion = FreeMotion([f.stamp_ns for f in frames], linked, followed=linked)
    return motion.worst_bridge(poses, [f.submap for f in frames])


def _displacement(T_a: Array, T_b: Array, centre: Array) -> Array:
    """Displacement (3,) of the target's centre between two poses of a submap."""
    return apply(T_a, apply(inverse(T_b), centre)) - centre
