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

"""The map of a scan: key frames, closures, the frames between them, and the frame that all poses are in."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise

import numpy as np

from debris_scanner.core.frames import KeyFrame, KeyPose, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse, log_so3, rotation_angle, transform
from debris_scanner.core.memory import release_memory
from debris_scanner.faults import rollback
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.evidence import sensor_evidence
from debris_scanner.mapping.keyframes import ViewCache
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.optimiser import PoseGraphSettings
from debris_scanner.mapping.pose_graph import PoseGraph
from debris_scanner.modelling.frame_store import FrameStore, StoredFrame, unbroken_ns
from debris_scanner.modelling.placement import Answer
from debris_scanner.sensing.depth_offset import NO_OFFSET
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.sensor_model import SensorModel, typical_sensor
from debris_scanner.sensing.views import View
from debris_scanner.tracking.cadence import Cadence

SAME_FACE = np.radians(10.0)  # between views of the same face
FIRST_MEASURED = 8  # key frames, when the sensor is first measured; then whenever they have doubled


class ScanMap:
    """Owner of all that was seen; poses move when an attempt at a model has succeeded, and are else put back.

    Not thread-safe: one worker drives it.

    Args:
        kept_frames: whose depth is kept for fusion, at most.
        graph: settings of the pose graph.
        normals: of the fits.
        information_scale: what registration's information is divided by.
    """

    def __init__(
        self, kept_frames: int, graph: PoseGraphSettings, normals: NormalSettings, information_scale: float
    ) -> None:
        self._kept_frames, self._normals = kept_frames, normals
        self._graph_settings, self._information_scale = graph, information_scale
        self.given = False  # a model was given beforehand, and is looked for
        self.reset()

    def reset(self) -> None:
        """Forget the scan."""
        self.graph = PoseGraph(self._graph_settings, self._normals, self._information_scale)
        self.store = FrameStore(self._kept_frames)
        self.T_model_scan: Array | None = None  # set by the first model
        self.answer = Answer('', '')  # of the latest match with the known model
        self.sensor: SensorModel | None = None  # as measured so far
        self.attitude_noise: float | None = None  # rad, of a frame's registration about each axis
        self._measured_with = FIRST_MEASURED // 2  # key frames
        self._measured_ns: list[int] | None = None  # stamps of those, which were free from this offset
        self._measured_offset = NO_OFFSET
        self.pending = False  # a closure has come since the last attempt
        self.same_face = False  # one of the closures shows the same face again
        self.generated_with = 0  # key frames, at the last attempt
        self._cadence = Cadence()
        self._followed_ns = 0  # stamp of the latest frame that moves with the last key frame
        self.lost = 0  # frames that showed a target and were not registered
        self.withdrawn_ns = -1  # up to this stamp a known model was tracked wrongly

    @property
    def keyframes(self) -> list[KeyPose]:
        """Poses of the key frames so far, in order of time."""
        return self.graph.keyframes.frames

    @property
    def views(self) -> ViewCache:
        """Views of the key frames, prepared when they are needed."""
        return self.graph.keyframes.views

    @property
    def members(self) -> list[int]:
        """Key frames, by index, whose poses can be compared with the newest one's."""
        return self.graph.keyframes.active

    @property
    def active(self) -> list[KeyPose]:
        """The same, by pose."""
        return [self.keyframes[k] for k in self.members]

    def add_frame(self, frame: TargetFrame, T_target_sensor: Array, tracked: bool) -> None:
        """Add an accepted frame; ``tracked`` poses are in the model's target frame, others in the scan's.

        It moves with the previous key frame. A tracked frame does so only if the target was tracked all the
        time since: then both have the same error after a relocalisation.
        """
        if self._is_withdrawn(tracked):
            return
        reference = self.keyframes[-1] if self.keyframes else None
        self._cadence.add(frame.stamp_ns)
        if reference is not None and tracked:
            last_ns = max(self._followed_ns, reference.stamp_ns)
            if frame.stamp_ns - last_ns > unbroken_ns(self._cadence):
                reference = None
        if reference is None:
            self.store.add(frame, None, T_target_sensor)
            return
        self._followed_ns = frame.stamp_ns
        T = T_target_sensor
        if not tracked and self.T_model_scan is not None:  # computed before the model existed
            T = compose(self.T_model_scan, T)
        self.store.add(frame, reference.stamp_ns, compose(inverse(reference.T_target_sensor), T))

    def add_keyframe(self, keyframe: KeyFrame, tracked: bool) -> None:
        """Add a key frame, before its frame is added."""
        if self._is_withdrawn(tracked):
            return
        if not tracked and self.T_model_scan is not None:  # computed before the model existed
            T = compose(self.T_model_scan, keyframe.T_target_sensor)
            keyframe = dataclasses.replace(keyframe, T_target_sensor=T)
        self.graph.add_keyframe(keyframe)
        if len(self.keyframes) >= 2 * self._measured_with:
            self._measured_with = len(self.keyframes)
            self.measure_sensor()

    def measure_sensor(self) -> SensorModel | None:
        """Measure the sensor on all key frames, once as long as these stay; None while they tell nothing."""
        keyframes, offset = self.graph.keyframes, self.views.offset
        frames = [keyframes.frames[k] for k in keyframes.active]
        linked = [frame.stamp_ns for frame in frames if frame.linked]
        if offset is self._measured_offset and linked == self._measured_ns:
            return self.sensor
        self._measured_offset, self._measured_ns = offset, linked
        self.sensor = sensor_evidence(keyframes) or self.sensor
        if self.sensor is not None and offset.rms > 0:
            focal = self.sensor.range_m / self.sensor.footprint_m
            self.sensor = dataclasses.replace(
                self.sensor, offset_m=offset.rms * self.sensor.range_m, offset_px=offset.length * focal
            )
        return self.sensor

    def sensor_for(self, views: Sequence[View]) -> SensorModel:
        """The sensor as the key frames show it, or as it is assumed to be for these views."""
        return self.measure_sensor() or typical_sensor(views)

    def add_closure(self, closure: Closure) -> None:
        """Add an accepted closure."""
        if min(closure.from_stamp_ns, closure.to_stamp_ns) <= self.withdrawn_ns:
            return
        self.graph.add_closure(closure)
        self.pending = True
        assert closure.T_from_to is not None
        self.same_face |= rotation_angle(closure.T_from_to[:3, :3]) <= SAME_FACE

    def withdraw(self, stamp_ns: int) -> None:
        """Up to a stamp the known model was tracked wrongly: look for it in what comes after that alone."""
        self.T_model_scan, self.withdrawn_ns = None, stamp_ns
        self.generated_with = 0
        self.store = FrameStore(self._kept_frames)

    def _is_withdrawn(self, tracked: bool) -> bool:
        """Whether a frame was tracked by a model that has been given up since."""
        return tracked and self.given and self.T_model_scan is None

    def comparable(self, with_model: bool) -> tuple[list[KeyPose], list[StoredFrame]]:
        """Key frames and frames of one submap: the model's, or without a model the largest."""
        counts = Counter(k.submap for k in self.keyframes)
        if not counts:
            return [], list(self.store.frames)
        chosen = self.keyframes[-1].submap if with_model else counts.most_common(1)[0][0]
        keyframes = [k for k in self.keyframes if k.submap == chosen]
        stamps = {k.stamp_ns for k in keyframes if k.usable_for_mapping or not with_model}
        return keyframes, [f for f in self.store.frames if f.keyframe_ns is None or f.keyframe_ns in stamps]

    def checkpoint(self) -> Callable[[], None]:
        """What puts back the state before an attempt, but that there was one: the next waits for more."""
        views, offset = self.views, self.views.offset
        put_back = rollback(self, self.graph, self.store, *self.keyframes, *self.store.frames)

        def restore() -> None:
            tried = self.pending, self.generated_with
            put_back()
            self.pending, self.generated_with = tried
            views.offset = offset

        return restore

    def rest(self) -> None:
        """Free what is needed while a model is made, and only then."""
        self.views.rest()
        release_memory()

    def note_slips(self, stamps_ns: Collection[int]) -> None:
        """Tracking slipped before these key frames: forget the frames since the ones before them."""
        for before, keyframe in pairwise(self.active):
            if keyframe.stamp_ns in stamps_ns:
                keyframe.slipped = True
                self.store.forget_between(before.stamp_ns, keyframe.stamp_ns)

    def note_noise(self, motion: MotionPrior, found: Sequence[Array], smoothed: Sequence[Array]) -> None:
        """How far smoothing moved the attitudes; without a measured motion nothing is known of it."""
        apart = [log_so3(T[:3, :3].T @ S[:3, :3]) for T, S in zip(found, smoothed, strict=True)]
        measured = np.isfinite(motion.angular_sigma)
        self.attitude_noise = float(np.sqrt(np.mean(np.square(apart)))) if measured else None

    def shift_origin(self, shift: Array) -> None:
        """Move the target frame's origin to ``shift`` (3,)."""
        T_new_old = transform(np.eye(3), -shift)
        self.graph.keyframes.move({}, T_new_old)
        for stored in self.store.frames:
            if stored.keyframe_ns is None:
                stored.T = compose(T_new_old, stored.T)
