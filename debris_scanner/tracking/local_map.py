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

"""The local map: what is known of the target, and how a frame near its prediction is registered to it.

Frames are registered to the key frames of the current submap, to partially occluded views until there is an
unoccluded one, and to the model once there is one.
"""

import math
from itertools import pairwise

import numpy as np

from debris_scanner.core.frames import KeyFrame, KeyPose, Model, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.sensing.depth_offset import DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import (
    FrameFit,
    OdometrySettings,
    Reference,
    ScanLevel,
    fit_frame,
    passes_gate,
    shows_unmapped_surface,
)
from debris_scanner.tracking.model_tracker import ModelTracker
from debris_scanner.tracking.motion_filter import MotionFilter
from debris_scanner.tracking.occlusion import LONGEST_OCCLUSION_NS, Occlusion
from debris_scanner.tracking.pose_search import tracking_surface
from debris_scanner.tracking.submaps import Submaps, choose_references

MIN_POINTS = 60  # a frame with fewer sampled surface points is not registered
SURPRISING = 1e-6  # share of fits of an even motion that lie farther from their prediction
GATES = (20.0, 13.0, 8.0, 8.0, 5.5, 5.5)  # px, shrinking over the iterations


class LocalMap:
    """Key frames, occlusion and model of the target, and the registration of frames to them.

    ``model``, ``surface``: None while scanning. ``settings``, and ``stretch`` of bounds in time for a slow
    sensor (:class:`Cadence`), are those of the latest frame.
    """

    def __init__(self, settings: OdometrySettings, normals: NormalSettings) -> None:
        self.settings, self.stretch = settings, 1.0
        self.submaps = Submaps(normals)
        self.level = ScanLevel()
        self._normals = normals
        self._clear()

    def begin_submap(self) -> None:
        """Go on without the model in a new submap: the rotation since the last one is unknown."""
        self.submaps.begin(travelled=np.pi)  # assumed; it may be more
        self._clear()

    def _clear(self) -> None:
        self.occlusion = Occlusion()
        self.model: Model | None = None
        self.surface: Surface | None = None
        self._tracker: ModelTracker | None = None

    def adopt(self, model: Model, poses: dict[int, Array], offset: DepthOffset) -> tuple[Array, Array]:
        """Register frames to a model from now on; arguments and errors as of :meth:`Odometry.adopt_model`.

        Returns:
            From the target frame so far to the model's (4, 4); the target's inertia (3, 3), any scale.
        """
        keyframes = self.submaps.keyframes
        known = [k for k in keyframes.frames if k.stamp_ns in poses]
        if not known:
            raise ValueError('the model shares no key frame with this odometry')
        last = known[-1]
        T_new_old = compose(poses[last.stamp_ns], inverse(last.T_target_sensor))
        keyframes.move(poses, T_new_old)
        keyframes.views.offset = offset
        self.occlusion.change_target_frame(T_new_old)
        self.model, self.surface = model, tracking_surface(model)
        self._tracker = ModelTracker(model, self._normals)
        return T_new_old, self._inertia(known, float(np.ptp(model.points, axis=0).max()))

    def _inertia(self, known: list[KeyPose], extent: float) -> Array:
        """The target's inertia (3, 3) as the rates at its key frames show it; else that of a sphere."""
        index = self.submaps.keyframes.index
        linked = [b.linked and index[b.stamp_ns] == index[a.stamp_ns] + 1 for a, b in pairwise(known)]
        stamps, poses = [k.stamp_ns for k in known], [k.T_target_sensor for k in known]
        return MotionPrior(stamps, linked, poses, self.submaps.keyframes.centre, extent, weight=1.0).inertia

    def prepare(self, frame: TargetFrame, settings: OdometrySettings, max_gap: float, stretch: float) -> View:
        """The next frame as a view, marked as occluded while the target is entering the view.

        Where more than max_gap seconds lie between two frames, the target was out of sight.
        """
        self.settings, self.stretch = settings, stretch
        view = self.submaps.keyframes.views.prepare(frame)
        # with a model few frames are prepared, and their pixels grow as their points would
        size = len(view.points) if self._tracker is None else frame.pixels
        if size >= MIN_POINTS:
            self.occlusion.add(frame.stamp_ns, size, max_gap, stretch)
        view.unoccluded = not self.occlusion.entering_view
        return view

    def shows_target(self, view: View) -> bool:
        """Whether a frame shows enough of it, and not an occluder's silhouette as it enters the view."""
        return len(view.points) >= MIN_POINTS and not self.occlusion.entering_view

    def references(self, motion: MotionFilter) -> list[Reference]:
        """What to register a frame to at a predicted state; empty if none of it was seen from nearby."""
        return choose_references(
            motion, self.submaps.keyframes, self.occlusion.partial, self.surface, self.settings
        )

    def register(self, predicted: MotionFilter, view: View, last: MotionFilter, dt: float) -> FrameFit | None:
        """The fit of a frame near its prediction, dt seconds after the filter of the last accepted frame.

        None without a reference seen from nearby, or with too few points.
        """
        if not (references := self.references(predicted)):
            return None
        if (fit := self._glance(predicted, view, references)) is not None:
            return fit
        if len(view.points) < MIN_POINTS:
            return None
        fit = _fit(predicted, view, references, last, dt)
        if self._hides(fit, view):
            # the occluder's edge must not count as the target's silhouette
            view.unoccluded = False
            fit = fit_frame(predicted, view, references, GATES)
        if self._restart_if_keyframes_occluded(fit, view, references):
            fit = fit_frame(predicted, view, references, GATES)
        return fit

    def add(self, fit: FrameFit, view: View, consistent: bool) -> KeyFrame | None:
        """Add an accepted frame; as a key frame, if it is unoccluded and the target has turned far enough.

        It becomes none unless its pose is consistent with a prediction.
        """
        view.unoccluded = not (self.occlusion.entering_view or self._hides(fit, view))
        self.occlusion.keep(view, fit.filter)
        self.level.add(fit, view.unoccluded)
        if not (view.unoccluded and consistent):
            return None
        return self.submaps.add_if_turned(view, fit.filter, self.model is not None, self.settings)

    def _glance(self, predicted: MotionFilter, view: View, references: list[Reference]) -> FrameFit | None:
        """The fit to the model alone, where nothing about it asks for a closer look."""
        if self._tracker is None or not view.unoccluded:
            return None
        near = [(surface, pose) for surface, pose in references if isinstance(surface, View)]
        fit = self._tracker.fit(predicted, view, near)
        if (
            fit is None
            or chance_beyond(fit.surprise) < SURPRISING
            or not passes_gate(fit, self.level, self.settings)
            or self._hides(fit, view)
        ):
            return None
        return fit

    def _hides(self, fit: FrameFit, view: View) -> bool:
        return self.occlusion.hides(fit, self.level, view.frame.stamp_ns, self.settings)

    def _restart_if_keyframes_occluded(self, fit: FrameFit, view: View, references: list[Reference]) -> bool:
        """Begin a new submap if a frame shows that the views of this young one are partially occluded."""
        if not (shows_unmapped_surface(fit, self.level, self.settings) and self._submap_is_young(view)):
            return False
        self.occlusion.mark_occluded(references)
        self.submaps.begin()
        view.unoccluded = False
        return True

    def _submap_is_young(self, view: View) -> bool:
        """Whether this submap's key frames may all be partially occluded: it is too young to tell."""
        return self.model is None and self.submaps.younger(
            view.frame.stamp_ns, round(LONGEST_OCCLUSION_NS * self.stretch)
        )


def _fit(
    predicted: MotionFilter, view: View, references: list[Reference], last: MotionFilter, dt: float
) -> FrameFit:
    """The frame's fit; where it surprises, the target may have been set in motion, or stopped."""
    fit = fit_frame(predicted, view, references, GATES)
    if chance_beyond(fit.surprise) >= SURPRISING:
        return fit
    other = fit_frame(last.released().predicted(dt), view, references, GATES)
    return min(fit, other, key=lambda f: f.loss)


def chance_beyond(squared: float) -> float:
    """Of six normal numbers: that they lie farther from their means than this squared distance in sigmas."""
    half = squared / 2
    return math.exp(-half) * (1 + half + half * half / 2)
