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

"""The verdict on a scan: do the key frames agree as posed, and can the target's rotation be observed?

Every question is answered in nats a point, by the likelihood of key frames given each other. Arcs of key
frames that contradict the rest are left out of the model while they are few, before the whole is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import parameter
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    NOT_RIGID,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
    Check,
    Checks,
    at_least,
    at_most,
    in_words,
)
from debris_scanner.mapping.bridging import FreeMotion
from debris_scanner.mapping.posed_views import RINGS, PosedViews
from debris_scanner.modelling.ambiguity import least_joining_loss, least_turning_loss, worst_turned_arc
from debris_scanner.modelling.consistency import Displacement, worst_arc, worst_link, worst_shifted_arc
from debris_scanner.modelling.rigidity import change_over_time
from debris_scanner.registration.kernels import MIN_OUTSIDE_COS
from debris_scanner.sensing.sensor_model import SensorModel
from debris_scanner.sensing.views import View, angles_between

NEIGHBOURS = 5  # key frames to either side of one that may have torn the motion
AFTER_GAP = (
    0.25  # of the least turning loss, of what was seen between two gaps: it was posed by its rate, too
)
MAX_DROPPED = 0.1  # share of the key frames that may be left out
LEAST_SHOWN = 0.5  # of a ball, seen from where the target was: a model of less is one of a side
BALL = 2000  # points of it
FEWEST = round(2 * np.pi / RINGS[-1])  # views of a turn: farther apart two have too little in common


@dataclass(frozen=True)
class VerdictSettings:
    """Bounds of a model that is published."""

    max_gain: float = parameter(
        0.08,
        'largest gain a point of moving consecutive key frames',
        'nat',
        0.001,
        10.0,
    )
    min_turning_loss: float = parameter(
        0.2,
        'least loss a point of turning a part of the scan',
        'nat',
        0.0,
        10.0,
    )


@dataclass(frozen=True)
class Verdict:
    """Whether posed key frames make a model; ``reason`` is None if they do."""

    reason: str | None
    why: str  # the checks in words
    checks: Checks
    dropped: tuple[int, ...] = ()  # key frames to be left out
    unplaced_ns: tuple[int, ...] = ()  # stamps of those of a part that may lie elsewhere as well
    slid: tuple[tuple[int, ...], Array] | None = None  # key frames that refused it, and their move (4, 4)

    def value(self, name: str) -> float:
        """What a check found; infinite where it was not asked."""
        return next((check.value for check in self.checks if check.name == name), np.inf)


@dataclass(frozen=True)
class PosedKeyFrames:
    """What the verdict is asked about: key frames in order of time."""

    views: Sequence[View]
    poses: Sequence[Array]  # T_target_view (4, 4)
    before: Sequence[Array]  # the same as tracked
    linked: Sequence[bool]  # whether each was registered to the one before
    followed: Sequence[bool]  # whether the target was in sight all the time since the one before
    placed: Sequence[int]  # by appearance alone, with others of the same number; 0: as it was tracked


def judge_poses(
    found: PosedKeyFrames, sensor: SensorModel, settings: VerdictSettings, final: bool = False
) -> Verdict:
    """The verdict on posed key frames.

    Args:
        found: the key frames.
        sensor: noise measured on the stream.
        settings: the bounds.
        final: no more views come: they must show more than a side.
    """
    asked = _Questions(found, sensor, settings)
    questions = [asked.agree, asked.observable, asked.observable_after_gaps, asked.joined, asked.rigid]
    for question in (*questions, asked.shown) if final else questions:
        if (refused := question()) is not None:
            return refused
    return asked.passed()


class _Questions:
    """The questions of a verdict, in their order; each gives the verdict that refuses, or None."""

    def __init__(self, found: PosedKeyFrames, sensor: SensorModel, settings: VerdictSettings) -> None:
        self.found, self.sensor, self.settings = found, sensor, settings
        self.members = list(range(len(found.views)))  # key frames that are not left out
        self.checks: list[Check] = []

    def agree(self) -> Verdict | None:
        """Do the key frames agree, without a few that contradict the others?"""
        found, members, most = self.found, self.members, self.settings.max_gain
        posed = PosedViews(found.views, found.poses, self.sensor)
        while True:
            slid = worst_shifted_arc(posed)
            displaced = [d for d in (worst_arc(posed), worst_turned_arc(posed), slid) if d is not None]
            worst = max(displaced, key=lambda d: d.gain, default=None)
            if worst is not None and worst.gain > most:
                named = at_fault = members[worst.arc.first : worst.arc.last + 1]
                wrong = worst
            else:
                torn = _torn(found, posed, members)
                if torn is None or torn.gain <= most:
                    break
                named, wrong = members[torn.arc.first - 1 : torn.arc.first + 1], torn
                # of the two key frames the one without which the motion is less torn
                remaining = tuple(members)
                at_fault = [min(named, key=lambda k: _gain_without(k, found, self.sensor, remaining))]
            posed = posed.without([members.index(k) for k in at_fault])
            members = [k for k in members if k not in at_fault]
            count, left = len(found.views), len(found.views) - len(members)
            if left > MAX_DROPPED * count:
                gain = at_most('gain', wrong.gain, most)
                left_out = at_most('left_out_share', left / count, MAX_DROPPED)
                refused = self._refused(
                    INCONSISTENT_MODEL, _contradiction(named, count, wrong), gain, left_out
                )
                return replace(refused, slid=(tuple(at_fault), wrong.move)) if wrong is slid else refused
        self.members, self.posed = members, posed
        if worst is not None:
            self.checks.append(at_most('gain', worst.gain, most))
        self.checks += _said(posed)
        return None

    def observable(self) -> Verdict | None:
        """Would they disagree, had a part of the scan turned by another angle?"""
        parts, least = _parts(self.members), self.settings.min_turning_loss
        loss, axis = min((least_turning_loss(self.posed, part) for part in parts), key=lambda f: f[0])
        self.checks.append(at_least('turning_loss', max(loss, 0.0), least))
        return None if loss >= least else self._refused(UNOBSERVABLE_ROTATION, _turned(self.posed, axis))

    def observable_after_gaps(self) -> Verdict | None:
        """Likewise, a part that is cut off by gaps?"""
        coarse, least = self.posed.coarse(), AFTER_GAP * self.settings.min_turning_loss
        for part in _parts(self.members, self.found.followed)[1:]:
            loss, axis = least_turning_loss(coarse, part)
            if loss < least:
                failed = at_least('turning_loss_after_gap', max(loss, 0.0), least)
                note = f'in a part cut off by gaps, {_turned(self.posed, axis)}'
                return self._refused(UNOBSERVABLE_ROTATION, note, failed)
        return None

    def joined(self) -> Verdict | None:
        """Would parts that were placed by appearance fit as well elsewhere?"""
        found, posed, members = self.found, self.posed, self.members
        placed = np.array([found.placed[k] for k in members])
        motion = FreeMotion(
            [v.frame.stamp_ns for v in posed.views],
            [k > 0 and k - 1 in members and found.linked[k] for k in members],
            [all(found.followed[a + 1 : b + 1]) for a, b in pairwise([-1, *members])],
        )
        for piece in np.unique(placed[placed > placed.min()]):
            joining = least_joining_loss(posed, placed == piece, motion)
            self.checks.append(at_least('joining_loss', joining, self.settings.min_turning_loss))
            if not self.checks[-1].passed:
                note = 'how its parts lie is not known: turned, the target looks the same'
                unplaced = [v.frame.stamp_ns for v, p in zip(posed.views, placed, strict=True) if p == piece]
                return self._refused(INCONSISTENT_MODEL, note, unplaced_ns=tuple(unplaced))
        return None

    def rigid(self) -> Verdict | None:
        """Do views of one place agree, however far apart in time?"""
        change = change_over_time(self.posed)
        return None if change is None else self._refused(NOT_RIGID, change.words, change.check)

    def shown(self) -> Verdict | None:
        """Do they show more than a side?"""
        self.checks.append(at_least('share_shown', share_shown(self.posed), LEAST_SHOWN))
        if self.checks[-1].passed:
            return None
        note = f'a loop closed, but the {len(self.members)} key frames look at one side alone of a ball'
        return self._refused(NO_CLOSURE, note)

    def passed(self) -> Verdict:
        """The verdict where none refuses."""
        dropped = tuple(k for k in range(len(self.found.views)) if k not in self.members)
        said = f'{len(self.members)} key frames agree'
        if dropped:
            said += f', {len(dropped)} that contradict them are left out'
        return Verdict(None, in_words(self.checks, said), tuple(self.checks), dropped)

    def _refused(self, reason: str, note: str, *failed: Check, unplaced_ns: tuple[int, ...] = ()) -> Verdict:
        every = (*self.checks, *failed)
        return Verdict(reason, in_words(every, note), every, unplaced_ns=unplaced_ns)


def _torn(found: PosedKeyFrames, posed: PosedViews, members: Sequence[int]) -> Displacement | None:
    """The step that fits best as it was tracked; steps lead past key frames that were left out."""
    steps = [
        n
        for n, (a, b) in enumerate(pairwise(members), start=1)
        if all(found.linked[k] for k in range(a + 1, b + 1))
    ]
    return worst_link(posed, [found.before[k] for k in members], steps)


def _gain_without(k: int, found: PosedKeyFrames, sensor: SensorModel, members: Sequence[int]) -> float:
    """How much the motion is still torn without a key frame, nats a point."""
    near = [m for m in members if m != k and abs(m - k) <= NEIGHBOURS]
    posed = PosedViews([found.views[m] for m in near], [found.poses[m] for m in near], sensor)
    torn = _torn(found, posed, near)
    return -np.inf if torn is None else torn.gain


def _parts(members: Sequence[int], followed: Sequence[bool] | None = None) -> list[NDArray[np.bool_] | None]:
    """What is turned to see whether it shows: half of the scan, and what dropped key frames cut off.

    What continuity does not tie to the rest must be tied by what it shows.

    Args:
        members: key frames that are left.
        followed: of all; cut where they were not, too.
    """
    cut = [b - a > 1 or (followed is not None and not followed[b]) for a, b in pairwise(members)]
    run = np.concatenate([[0], np.cumsum(cut)])
    return [None, *(run == k for k in range(run[-1] + 1) if run[-1])]


def share_shown(posed: PosedViews) -> float:
    """Share of a ball in the target's place that the views show, as obliquely as real sensors see."""
    k = np.arange(BALL) + 0.5
    z, turn = 1 - 2 * k / BALL, np.pi * (1 + np.sqrt(5)) * k  # evenly on the ball, along a spiral
    r = np.sqrt(1 - z**2)
    ball = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    eyes = np.array([T[:3, 3] for T in posed.poses]) - posed.centre
    eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
    return float(np.mean((ball @ eyes.T).max(axis=1) > MIN_OUTSIDE_COS))


def judge_scan(frames: int, posed: PosedViews | None, settings: VerdictSettings, lost: int = 0) -> Verdict:
    """Why a scan without a closed loop has no model.

    Args:
        frames: that showed a target and were registered.
        posed: some of them; None if there are none.
        settings: the bounds.
        lost: frames that showed a target and were not registered.
    """
    checks: Checks = (at_most('frames_that_fit_none', lost, frames),) if lost else ()
    if lost > frames:
        note = (
            f'{frames + lost} frames showed a target: it turned too far from one to the next, or too little '
            'of it shows its turn'
        )
        return Verdict(TOO_FEW_FRAMES, in_words(checks, note), checks)
    checks += (at_least('frames', frames, FEWEST),)
    if frames == 0 or posed is None:
        return Verdict(NO_TARGET, 'no frame showed a target in the box', checks)
    if frames < FEWEST:
        return Verdict(TOO_FEW_FRAMES, in_words(checks, 'too few for a turn showed a target'), checks)
    loss, axis = least_turning_loss(posed)
    checks += (at_least('turning_loss', max(loss, 0.0), settings.min_turning_loss),)
    if loss < settings.min_turning_loss:
        return Verdict(UNOBSERVABLE_ROTATION, in_words(checks, _turned(posed, axis)), checks)
    apart = np.degrees(angles_between(posed.views, posed.poses).max())
    why = f'no face was seen a second time: {frames} frames look at it from at most {apart:.0f} deg apart'
    return Verdict(NO_CLOSURE, why, (*checks, at_least('closures', 0, 1)))


def _contradiction(members: Sequence[int], count: int, found: Displacement) -> str:
    """Which key frames contradict the others, counted from 1, and how."""
    which = (
        f'key frame {members[0] + 1}'
        if len(members) == 1
        else f'key frames {members[0] + 1} to {members[-1] + 1}'
    )
    fit = 'fits' if len(members) == 1 else 'fit'
    return (
        f'{which} of {count} {fit} better turned by {np.degrees(found.turn):.1f} deg and shifted by '
        f'{found.shift * 1e3:.1f} mm'
    )


def _said(posed: PosedViews) -> list[Check]:
    """What the colours of the views said for their poses, and their shapes, nats a point; [] without."""
    pairs = posed.pairs_at(posed.pairs)
    colours, points = sum(pair.picture for pair in pairs), sum(pair.points for pair in pairs)
    if colours <= 0 or points <= 0:
        return []
    shape = sum(pair.log_likelihood for pair in pairs) - colours
    return [Check('colours', colours / points), Check('shape', shape / points)]


def _turned(posed: PosedViews, axis: Array) -> str:
    about = ', '.join(f'{a:.2f}' for a in axis)
    said = f'turned about ({about}) the target looks the same'
    if any(v.picture is not None and v.picture.level(coarse=True) is not None for v in posed.views):
        return said
    return f'{said}; the frames have no picture beside the depth, which would show how a marked target turns'
