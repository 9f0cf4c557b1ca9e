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

"""Loop-closure detection: which earlier key frame shows the face that is seen now?

Each key frame is described (EFPFH) and compared with all earlier ones. The similarity, joined with the
attitude estimate, is the probability of a closure (Trowbridge 2014, eq. 2.102). The best candidates are
verified by geometry: registration must show that two views see the same surface. Every hypothesis is
returned with the numbers that decided it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import Array, compose, exp_se3, inverse, log_se3, rotation_angle
from debris_scanner.core.parameters import parameter
from debris_scanner.core.results import (
    Check,
    Checks,
    ClosureRecord,
    Descriptions,
    at_least,
    at_most,
    in_words,
    passed,
)
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closure_search import (
    ClosureSearchSettings,
    attitude_probability,
    candidates,
    joint_probability,
)
from debris_scanner.mapping.descriptors import DescriptorSettings, PerBinThreshold, binary_similarity, efpfh
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.submap_closures import (
    ANOTHER_SUBMAP,
    JOINS_A_SUBMAP,
    NO_OVERLAP,
    NO_OVERLAP_WORDS,
    Proposal,
    Proposals,
    contradiction,
    register_at_any_roll,
)
from debris_scanner.registration.likelihood import UsualLoss, frame_loss, mutual_loss
from debris_scanner.registration.projective import MIN_OVERLAP, RegistrationStats, register
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View

PREPARED = 8  # views: each is used when it is new, and perhaps once more, a revolution later
ASKED = 5  # steps between two key frames that a closure is put to
USUAL_SHARE = 0.9  # of the steps: what these disagree by, a closure may ask of a step
FEW = 5  # steps, from which on it is known what they disagree by


@dataclass(frozen=True)
class VerificationSettings:
    """The bound of an accepted closure's fit. It separates front from back, not a prism's faces."""

    max_loss: float = parameter(
        0.6,
        'views may lose so much beyond consecutive key frames',
        'nat',
        0.05,
        10.0,
    )


@dataclass(frozen=True)
class Verification:
    """Outcome: the corrected pose, and the checks that decided."""

    accepted: bool
    why: str  # the checks in words
    T_target_view: Array | None  # (4, 4), registered; None where registration failed
    stats: RegistrationStats
    checks: Checks


class Steps:
    """The steps from key frame to key frame: what they disagree by, and what a closure asks of them.

    A closure turns the end of a chain of steps, so each gives way by its share. Where that is more than the
    steps of this scan, by their views, give way to each other, the closure is not this sensor's drift: the
    face of a prism that is taken for its neighbour asks for a whole face. All in nats a point.
    """

    def __init__(self, keyframes: KeyFrameSet) -> None:
        self._keyframes = keyframes
        self._disagreements: list[tuple[float, float]] = []  # nats a point, rad

    def learn(self) -> None:
        """Compare the newest key frame's pose with where it registers to the last but one."""
        frames, views = self._keyframes.frames, self._keyframes.views
        if len(frames) < 3 or not (frames[-1].linked and frames[-2].linked):
            return
        view, T, earlier = views[-1], frames[-1].T_target_sensor, (views[-3], frames[-3].T_target_sensor)
        found = register(view, T, *earlier)
        if found is None or found[1].stats.overlap < MIN_OVERLAP:
            return
        lost = mutual_loss(view, T, *earlier) - mutual_loss(view, found[0], *earlier)
        if np.isfinite(lost):
            turn = rotation_angle(compose(found[0], inverse(T))[:3, :3])
            self._disagreements.append((lost, turn))

    def asked(self, first: int, last: int, correction: Array) -> tuple[float, float]:
        """What a correction (4, 4) of the last key frame's pose asks of a step, and may ask, nats a point.

        It asks nothing where each step from the first key frame on turns by less than steps disagree by.
        """
        if len(self._disagreements) < FEW:
            return 0.0, np.inf
        most, turn = np.quantile(self._disagreements, USUAL_SHARE, axis=0)
        frames, views = self._keyframes.frames, self._keyframes.views
        steps = [k for k in range(first + 1, last + 1) if frames[k].linked]
        if rotation_angle(correction[:3, :3]) <= turn * len(steps):
            return 0.0, float(most)
        begin, path = frames[first].path_rad, frames[last].path_rad - frames[first].path_rad
        twist, costs = log_se3(correction), []
        for n in np.unique(np.linspace(0, len(steps) - 1, min(ASKED, len(steps))).astype(int)):
            k = steps[n]
            now, then = (frames[j].T_target_sensor for j in (k, k - 1))
            asked_now, asked_then = (
                compose(exp_se3((frames[j].path_rad - begin) / path * twist), T)
                for j, T in ((k, now), (k - 1, then))
            )
            lost = mutual_loss(views[k], now, views[k - 1], then)
            if np.isfinite(lost):  # else the two views have too little in common to be asked
                costs.append(mutual_loss(views[k], asked_now, views[k - 1], asked_then) - lost)
        return float(np.mean(costs)) if costs else 0.0, float(most)


def verify(
    view: View,
    T_target_view: Array,
    reference: View,
    T_target_reference: Array,
    settings: VerificationSettings,
    usual: UsualLoss | None = None,
    asked: Callable[[Array], tuple[float, float]] | None = None,
    start: Array | None = None,
) -> Verification:
    """Register a view to an earlier one and check the result against the bounds.

    Args:
        view: the newer view.
        T_target_view: its pose (4, 4) by odometry.
        reference: the earlier view.
        T_target_reference: its pose (4, 4).
        settings: the bounds.
        usual: loss of consecutive key frames; None while it is not known.
        asked: what a correction (4, 4) asks of each step between the two, and may ask, nats a point.
        start: pose (4, 4) from which the view is registered; None: the one by odometry.
    """
    found = register(view, T_target_view if start is None else start, reference, T_target_reference)
    if found is None:
        return Verification(False, NO_OVERLAP_WORDS, None, RegistrationStats(), (NO_OVERLAP,))
    T, lin = found
    correction = compose(T, inverse(T_target_view))
    excess = (usual or UsualLoss()).excess(mutual_loss(view, T, reference, T_target_reference))
    checks = [
        at_least('overlap', lin.stats.overlap, MIN_OVERLAP),
        at_most('excess_loss', excess, settings.max_loss),
    ]
    if asked is not None and passed(checks):
        checks.append(at_most('asked_of_a_step', *asked(correction)))
    checks.append(Check('correction_deg', float(np.degrees(rotation_angle(correction[:3, :3])))))
    return Verification(passed(checks), in_words(checks), T, lin.stats, tuple(checks))


@dataclass(frozen=True)
class ClosureSettings:
    """Which candidates are worth a geometric verification."""

    max_view_angle_deg: float = parameter(25.0, 'candidates look from directions so close', 'deg', 1.0, 90.0)
    verified: int = parameter(2, 'candidates verified a key frame', '', 1, 100)


@dataclass(frozen=True)
class Closure:
    """A hypothesis that two key frames show the same face."""

    from_stamp_ns: int  # the earlier key frame
    to_stamp_ns: int
    probability: float
    accepted: bool
    why: str  # the checks in words
    T_from_to: Array | None  # (4, 4), registered; None where the views were never registered
    checks: Checks = ()

    @property
    def record(self) -> ClosureRecord:
        """Its entry in summary.json."""
        return ClosureRecord(
            self.from_stamp_ns,
            self.to_stamp_ns,
            self.probability,
            self.accepted,
            self.why,
            self.T_from_to,
            self.checks,
        )


def descriptions(keyframes: KeyFrameSet, settings: DescriptorSettings) -> Descriptions:
    """The scan's own key frames, described as a detector does; slow, for the end of a scan."""
    own = [k for k, frame in enumerate(keyframes.frames) if not frame.added]
    views = (keyframes.views[k] for k in own)
    histograms = [efpfh(view.points, view.normals, settings) for view in views]
    return Descriptions(
        np.array([keyframes.frames[k].stamp_ns for k in own], dtype=np.int64),
        np.array(histograms, np.float32).reshape(len(own), -1 if own else 0),
        np.array([keyframes.frames[k].T_target_sensor[:3, :3] for k in own]).reshape(-1, 3, 3),
    )


class ClosureDetector:
    """Takes key frames in order of time and returns the closure hypotheses of each."""

    def __init__(
        self,
        settings: ClosureSettings,
        search: ClosureSearchSettings,
        descriptor: DescriptorSettings,
        verification: VerificationSettings,
        normals: NormalSettings,
        timer: StageTimer | None = None,
    ) -> None:
        self.settings = settings
        self.search = search
        self.descriptor = descriptor
        self.verification = verification
        self.normals = normals
        self.timer = timer or StageTimer()
        self.reset()

    def configure(
        self, settings: ClosureSettings, search: ClosureSearchSettings, verification: VerificationSettings
    ) -> None:
        """Take the settings that may change during a scan."""
        self.settings, self.search, self.verification = settings, search, verification

    def reset(self) -> None:
        """Forget all key frames."""
        self.keyframes = KeyFrameSet(self.normals, PREPARED)
        self.best_probability = 0.0  # joint, of the newest key frame's candidates
        self._descriptors = PerBinThreshold()
        self._usual, self._steps = UsualLoss(), Steps(self.keyframes)
        self._proposals = Proposals()

    @property
    def descriptions(self) -> Descriptions:
        """Descriptors and attitudes of all key frames so far; another thread may ask while frames come."""
        histograms = self._descriptors.histograms.copy()
        frames = self.keyframes.frames[: len(histograms)]
        return Descriptions(
            np.array([k.stamp_ns for k in frames], dtype=np.int64),
            histograms,
            np.array([k.T_target_sensor[:3, :3] for k in frames]).reshape(-1, 3, 3),
        )

    def remember(self, keyframe: KeyFrame) -> int:
        """Add and describe a key frame without searching for closures; returns its index."""
        with self.timer.stage('descriptor'):
            self.keyframes.add(keyframe)
            view = self.keyframes.views[-1]
            if self.keyframes.frames[-1].linked:
                before = self.keyframes.frames[-2]
                self._usual.add(
                    frame_loss(
                        view, keyframe.T_target_sensor, self.keyframes.views[-2], before.T_target_sensor
                    )[0]
                )
            self._steps.learn()
            return self._descriptors.add(efpfh(view.points, view.normals, self.descriptor))

    def add(self, keyframe: KeyFrame) -> list[Closure]:
        """Add a key frame; returns its verified closure hypotheses."""
        index = self.remember(keyframe)
        if index == 0:
            return []
        with self.timer.stage('closure_search'):
            ranked = self._candidates(index)
        closures = []
        with self.timer.stage('verification'):
            for k, probability in ranked:
                outcome = self.verify(k, index)
                closures.append(self._make_closure(k, keyframe, probability, outcome))
            return closures + self._between_submaps(index)

    def verify(self, earlier: int, later: int, start: Array | None = None) -> Verification:
        """Whether two key frames, by index, show one face; ``start`` as of :func:`verify`."""
        frames, views = self.keyframes.frames, self.keyframes.views
        return verify(
            views[later],
            frames[later].T_target_sensor,
            views[earlier],
            frames[earlier].T_target_sensor,
            self.verification,
            self._usual,
            partial(self._steps.asked, earlier, later),
            start,
        )

    def _between_submaps(self, index: int) -> list[Closure]:
        """Hypotheses that the new key frame shows a face of another submap; two that agree merge it."""
        frames, views = self.keyframes.frames, self.keyframes.views
        newest = frames[index]
        others = [k for k in range(index) if frames[k].submap != newest.submap]
        if not others:
            return []
        similarity = binary_similarity(self._descriptors.hamming_to_earlier(index))
        closures = []
        for k in sorted(others, key=lambda k: -similarity[k])[: self.settings.verified]:
            fit = register_at_any_roll(views[index], views[k], self._usual, self.verification.max_loss)
            T, checks = fit.T_earlier_view, fit.checks
            probability, earlier = float(similarity[k]), frames[k]
            if T is None or not fit.certain:
                closures.append(
                    Closure(earlier.stamp_ns, newest.stamp_ns, probability, False, fit.why, T, checks)
                )
                continue
            T_active_submap = compose(newest.T_target_sensor, inverse(T), inverse(earlier.T_target_sensor))
            proposal = Proposal(earlier.submap, k, index, probability, T, T_active_submap)
            rotations = [f.T_target_sensor[:3, :3] for f in frames]
            agreed = self._proposals.match(
                newest.submap, proposal, rotations, self.keyframes.centre, views[index].footprint
            )
            checks += (at_least('agreeing_views', 1 if agreed is None else 2, 2),)
            if agreed is not None:
                checks += contradiction(
                    self.keyframes,
                    earlier.submap,
                    T_active_submap,
                    self._usual,
                    self.verification.max_loss,
                )
            if agreed is None or not passed(checks):
                why = in_words(checks, ANOTHER_SUBMAP)
                closures.append(
                    Closure(earlier.stamp_ns, newest.stamp_ns, probability, False, why, T, checks)
                )
                continue
            why = in_words(checks, JOINS_A_SUBMAP)
            for p in (agreed, proposal):
                pair = frames[p.from_index].stamp_ns, frames[p.to_index].stamp_ns
                closures.append(Closure(*pair, p.probability, True, why, p.T_from_to, checks))
            self.keyframes.join(earlier.stamp_ns, newest.stamp_ns, T)
            break
        return closures

    def _make_closure(self, k: int, keyframe: KeyFrame, probability: float, outcome: Verification) -> Closure:
        """The hypothesis that a key frame shows the same face as the earlier one k, after verification."""
        earlier = self.keyframes.frames[k]
        T = outcome.T_target_view
        return Closure(
            earlier.stamp_ns,
            keyframe.stamp_ns,
            probability,
            outcome.accepted,
            outcome.why,
            None if T is None else compose(inverse(earlier.T_target_sensor), T),
            outcome.checks,
        )

    def _candidates(self, index: int) -> list[tuple[int, float]]:
        """Indices and joint probabilities of the key frames to verify, best first."""
        newest, earlier = self.keyframes.frames[index], self.keyframes.frames[:index]
        similarity = binary_similarity(self._descriptors.hamming_to_earlier(index))
        rotations = np.array([k.T_target_sensor[:3, :3] for k in earlier])
        attitude = attitude_probability(newest.T_target_sensor[:3, :3], rotations)
        probability = joint_probability(similarity, attitude)
        paths = np.array([k.path_rad for k in earlier])
        stamps = np.array([k.stamp_ns for k in earlier], dtype=np.int64)
        angles = self.keyframes.view_angles(newest.T_target_sensor, self.keyframes.centre)[:index]
        far = (np.abs(newest.path_rad - paths) >= self.search.min_path) & np.isfinite(angles)
        self.best_probability = float(probability[far].max()) if far.any() else 0.0
        near = angles < np.radians(self.settings.max_view_angle_deg)
        best = candidates(
            stamps, probability, paths, newest.path_rad, self.search, near, self.settings.verified
        )
        return [(c.index, c.probability) for c in best]
