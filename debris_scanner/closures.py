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

"""Loop closure detection: which earlier key frame shows the face that is seen now?

Each key frame is described (EFPFH), compared with all earlier ones, joined with the attitude
estimate to the probability of Trowbridge 2014, eq. 2.102, and the best candidates are verified
geometrically. Every hypothesis leaves with the numbers it was decided by.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.binary_efpfh import PerBinThreshold
from debris_scanner.closure_probability import attitude_probability, joint_probability
from debris_scanner.closure_search import ClosureSearchSettings, candidates
from debris_scanner.efpfh import DescriptorSettings, efpfh
from debris_scanner.frames import KeyFrame
from debris_scanner.geometry import Array, compose, inverse, rotation_angle
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.normals import NormalSettings
from debris_scanner.parameters import parameter
from debris_scanner.results import ClosureRecord, Descriptions
from debris_scanner.similarity import binary_similarity
from debris_scanner.submap_closures import Proposal, Proposals, agree, find_turn
from debris_scanner.timing import StageTimer
from debris_scanner.verification import Verification, VerificationSettings, verify

PREPARED = 8  # views: each is asked for when it is new, and perhaps once more, a turn later


@dataclass(frozen=True)
class ClosureSettings:
    """Which candidates are worth a geometric verification."""

    max_view_angle_deg: float = parameter(
        25.0, 'candidates are estimated to be seen from directions this close', 'deg', 1.0, 90.0
    )
    accepted_angle_deg: float = parameter(
        10.0,
        'registered attitudes of a closure are this close: the loop is closed, not nearly',
        'deg',
        1.0,
        90.0,
    )
    patience: float = parameter(
        7.0,
        'from this much rotation on, a face that comes back rolled about the line of sight will do',
        'rad',
        0.0,
    )
    verified: int = parameter(2, 'candidates verified a key frame', '', 1, 100)


@dataclass(frozen=True)
class Closure:
    """A hypothesis that two key frames show the same face."""

    from_stamp_ns: int  # the earlier key frame
    to_stamp_ns: int
    probability: float
    accepted: bool
    why: str
    T_from_to: Array  # (4, 4), registered where accepted

    @property
    def record(self) -> ClosureRecord:
        """What summary.json tells of it."""
        return ClosureRecord(self.from_stamp_ns, self.to_stamp_ns, self.probability, self.accepted, self.why)


class ClosureDetector:
    """Takes key frames in order of time and returns the hypotheses each one raises."""

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

    def reset(self) -> None:
        """Forget all key frames."""
        self.keyframes = KeyFrameSet(self.normals, PREPARED)
        self.best_probability = 0.0  # joint, of the newest key frame's candidates
        self._descriptors = PerBinThreshold()
        self._proposals = Proposals()

    @property
    def descriptions(self) -> Descriptions:
        """Descriptors and attitudes of all key frames so far."""
        frames = self.keyframes.frames
        return Descriptions(
            np.array([k.stamp_ns for k in frames], dtype=np.int64),
            self._descriptors.histograms.copy(),
            np.array([k.T_target_sensor[:3, :3] for k in frames]).reshape(-1, 3, 3),
        )

    def remember(self, keyframe: KeyFrame) -> int:
        """Describe a key frame without asking what it closes; its index."""
        with self.timer.stage('descriptor'):
            self.keyframes.add(keyframe)
            view = self.keyframes.views[-1]
            return self._descriptors.add(efpfh(view.points, view.normals, self.descriptor))

    def add(self, keyframe: KeyFrame) -> list[Closure]:
        """Hypotheses that the new key frame raises, those worth a verification."""
        index = self.remember(keyframe)
        view = self.keyframes.views[-1]
        if index == 0:
            return []
        with self.timer.stage('closure_search'):
            ranked = self._candidates(index)
        closures = []
        with self.timer.stage('verification'):
            for k, probability in ranked:
                earlier = self.keyframes.frames[k]
                outcome = verify(
                    view,
                    keyframe.T_target_sensor,
                    self.keyframes.views[k],
                    earlier.T_target_sensor,
                    self.verification,
                )
                closures.append(self._judged(k, keyframe, probability, outcome))
            return closures + self._between_submaps(index)

    def _between_submaps(self, index: int) -> list[Closure]:
        """Hypotheses that the new key frame shows a face of another submap; two that agree join it."""
        frames, views = self.keyframes.frames, self.keyframes.views
        newest = frames[index]
        others = [k for k in range(index) if frames[k].submap != newest.submap]
        if not others:
            return []
        similarity = binary_similarity(self._descriptors.hamming_to_earlier(index))
        closures = []
        for k in sorted(others, key=lambda k: -similarity[k])[: self.settings.verified]:
            T, why = find_turn(views[index], views[k])
            probability, earlier = float(similarity[k]), frames[k]
            if T is None:
                closures.append(
                    Closure(earlier.stamp_ns, newest.stamp_ns, probability, False, why, np.eye(4))
                )
                continue
            T_active_submap = compose(newest.T_target_sensor, inverse(T), inverse(earlier.T_target_sensor))
            proposal = Proposal(earlier.submap, k, index, probability, T, T_active_submap)
            turns = [f.T_target_sensor[:3, :3] for f in frames]
            agreed = self._proposals.second(newest.submap, proposal, turns, self.keyframes.centre)
            contradicted = '' if agreed is None else agree(self.keyframes, earlier.submap, T_active_submap)
            if agreed is None or contradicted:
                why = f'{why}; {contradicted}' if contradicted else why
                closures.append(Closure(earlier.stamp_ns, newest.stamp_ns, probability, False, why, T))
                continue
            for p in (agreed, proposal):
                pair = frames[p.from_index].stamp_ns, frames[p.to_index].stamp_ns
                closures.append(Closure(*pair, p.probability, True, f'joins a submap: {why}', p.T_from_to))
            self.keyframes.join(earlier.stamp_ns, newest.stamp_ns, T)
            break
        return closures

    def _judged(self, k: int, keyframe: KeyFrame, probability: float, outcome: Verification) -> Closure:
        """The hypothesis that a key frame shows the face of the earlier one k, once verified."""
        earlier = self.keyframes.frames[k]
        accepted, why, T = outcome.accepted, outcome.why, outcome.T_target_view
        angle = np.degrees(rotation_angle(T[:3, :3].T @ earlier.T_target_sensor[:3, :3]))
        if keyframe.path_rad > self.settings.patience:
            angle = np.degrees(self.keyframes.view_angles(T, self.keyframes.centre)[k])
        if accepted and angle > self.settings.accepted_angle_deg:
            accepted = False
            why = f'apart_deg {angle:.3g} not <= {self.settings.accepted_angle_deg:.3g}; {why}'
        return Closure(
            earlier.stamp_ns,
            keyframe.stamp_ns,
            probability,
            accepted,
            why,
            compose(inverse(earlier.T_target_sensor), T),
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
