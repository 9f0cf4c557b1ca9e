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

"""A frame of a tracked target, fitted to the model alone: in raw depth, near its prediction.

It takes a fraction of the time of :func:`debris_scanner.tracking.gating.fit_frame`: of the frame, nothing is
prepared but planes in some of its rows, on which the loss is measured. A model that is fused from depth
images has no sharp edges: those are the key frames'. Where the model lacks much of what the frame shows, key
frames have to help, and the fit is left to others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, apply, inverse, logarithm, parts
from debris_scanner.core.optional import kernel
from debris_scanner.registration.likelihood import BeamModel, frame_loss, typical_beam
from debris_scanner.registration.model_terms import accumulate_edges, accumulate_model, points_on_rows
from debris_scanner.registration.projective import OBSERVABLE, linearise, rotation_observability
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View
from debris_scanner.tracking.gating import FrameFit
from debris_scanner.tracking.motion_filter import MotionFilter, updated
from debris_scanner.tracking.pose_search import tracking_surface

Image = NDArray[np.float32]

GATES = (8.0, 4.0, 2.5)  # px, of the iterations
STEPS = (16, 8, 1)  # of the points, one in so many is used in each
POINTS = 16000  # of the model: with 3000 the pose wanders twice as much
MODEL_WEIGHT = 0.5  # of a model's point
EDGES_WEIGHT = 0.1  # of a point on an edge of a key frame
ROWS = 16  # of the image, of which one is judged
JUDGED_PX = 5.5  # as other fits are
ORIGIN = np.eye(4)
COVERED = 0.85  # of the largest share of a frame that the model ever had: below, key frames help


@dataclass
class _Side:
    """What a key frame lends to the model: its edges in the model's frame, its noise."""

    pose: Array
    edges: tuple[Image, Image, Image]  # points, normals, directions out of their faces
    beam: BeamModel

    @staticmethod
    def of(view: View, pose: Array) -> '_Side':
        edges, R = view.edge_points, pose[:3, :3].T.astype(np.float32)
        points = np.asarray(apply(pose, edges.points), np.float32)
        return _Side(pose, (points, edges.normals @ R, edges.outward @ R), typical_beam(view))


class ModelTracker:
    """Fits frames to a model."""

    def __init__(self, model: Model, normals: NormalSettings) -> None:
        self._surface = tracking_surface(model, POINTS)
        self._normals = normals
        self._most = 0.0  # of a frame, that the model had
        self._sides: dict[int, _Side] = {}  # by stamp

    def fit(self, prior: MotionFilter, view: View, near: list[tuple[View, Array]]) -> FrameFit | None:
        """A frame's fit, near its prediction; None where that takes a closer look.

        Args:
            prior: the predicted filter; left unchanged.
            view: the frame.
            near: key frames seen from nearby, the nearest first, with their poses.
        """
        if not near or near[0][0].porous:
            return None
        like, sides = near[0][0], [self._side(*other) for other in near]
        edges = (np.concatenate(kind) for kind in zip(*(side.edges for side in sides), strict=True))
        resolution = like.resolution / like.footprint * view.footprint
        motion = prior.copy()
        try:
            motion.R, mean, motion.P, covered, surprise = _fitted(
                prior.R, prior.mean, prior.P, prior.settings.information_scale,
                self._surface.points, self._surface.normals, *edges, view.frame.depth, view.intrinsics,
                resolution, np.array(GATES), np.array(STEPS), MODEL_WEIGHT, EDGES_WEIGHT,
            )  # fmt: skip
        except np.linalg.LinAlgError:
            return None
        motion.set_mean(mean)
        share = covered * self._surface.point_area / view.frame.pixels
        self._most = max(self._most, share)
        if not share >= COVERED * self._most or not motion.is_finite:
            return None
        fit = self._judged(motion, view, near[0], sides[0].beam)
        fit.surprise = surprise
        # where the shape does not show its turn the picture may, if there is one
        return None if view.frame.rgb is not None and fit.observability < OBSERVABLE else fit

    def _judged(
        self, motion: MotionFilter, view: View, near: tuple[View, Array], beam: BeamModel
    ) -> FrameFit:
        """How the frame agrees with the model, on some of its rows."""
        T_view_model = motion.T_sensor_target
        T = inverse(T_view_model)
        chosen = points_on_rows(self._surface.points, *parts(T_view_model), view.intrinsics, ROWS)
        surface = self._surface.only(chosen)
        glimpse = view.glimpse(self._normals, ROWS, near[0])
        lin = linearise(surface, ORIGIN, glimpse, T, JUDGED_PX)
        stats = lin.stats
        loss, covered_loss = frame_loss(glimpse, T, surface, ORIGIN, beam)
        return FrameFit(
            motion,
            stats,
            rotation_observability(lin.H, stats.matched, *near),
            overlap=stats.visible_inlier_ratio,
            visible_inlier_ratio=stats.visible_inlier_ratio,
            missing_reference_ratio=stats.silhouette_violation_ratio,
            has_unoccluded_reference=True,
            loss=loss,
            covered_loss=covered_loss,
        )

    def _side(self, view: View, pose: Array) -> _Side:
        stamp = view.frame.stamp_ns
        side = self._sides.get(stamp)
        if side is None or side.pose is not pose:
            side = self._sides[stamp] = _Side.of(view, pose)
        return side


@kernel()
def _fitted(
    prior_R: Array, prior_mean: Array, prior_P: Array, scale: float, points: Image, normals: Image,
    edges: Image, edge_normals: Image, outward: Image, depth: Image, intrinsics: Array, resolution: float,
    gates: Array, steps: NDArray[np.intp], weight: float, edge_weight: float,
) -> tuple[Array, Array, Array, float, float]:  # fmt: skip
    """The filter after an iteration for each gate: attitude, mean and covariance.

    Then what the points cover that match in the last (:func:`accumulate_model`), and the squared distance
    from the prediction, in sigmas.
    """
    information = np.ascontiguousarray(np.linalg.inv(prior_P + 1e-14 * np.eye(len(prior_P))))
    R, mean, P, covered = prior_R, prior_mean, prior_P, 0.0
    for k in range(len(gates)):
        t = mean[0:3] - R @ mean[15:18]
        H, g = np.zeros((6, 6)), np.zeros(6)
        covered = accumulate_model(
            points, normals, R, t, depth, intrinsics, resolution, gates[k] * resolution, steps[k] * weight,
            steps[k], H, g,
        )  # fmt: skip
        accumulate_edges(edges, edge_normals, outward, R, t, depth, intrinsics, resolution, edge_weight, H, g)
        for i in range(6):
            g[i] /= resolution * resolution
            for j in range(i, 6):
                H[i, j] /= resolution * resolution
                H[j, i] = H[i, j]
        R, mean, P, _ = updated(R, mean, prior_R, prior_mean, information, H, g, scale)
    off = np.empty(len(prior_P))
    off[:3], off[3:] = logarithm(R @ prior_R.T), mean - prior_mean
    return R, mean, P, covered, float(off @ (information @ off))
