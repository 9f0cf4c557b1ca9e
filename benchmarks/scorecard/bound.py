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

"""The bound set by the sensor: the same fusion with the true poses, judged like a scan."""

from collections.abc import Sequence

import numpy as np

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array, compose, exp_se3, inverse, rotation_angle, transform
from debris_scanner.core.results import NO_TARGET, StampedPose
from debris_scanner.io.result_files import ScanResult
from debris_scanner.modelling.refinement import fuse, make_model
from debris_scanner.registration.projective import linearise, solve_step
from debris_scanner.sensing.views import Surface, View
from debris_scanner.settings import Settings
from debris_scanner.tracking.pose_search import tracking_surface

POINTS = 6000  # of the model
GATES = (13.0, 8.0, 8.0, 5.5, 5.5)  # px
UNOCCLUDED = 0.5  # of the median number of pixels; a frame with fewer is partially occluded


def true_pose_result(frames: Sequence[tuple[TargetFrame, Array]], settings: Settings) -> ScanResult:
    """The result of a scan with all poses known.

    Args:
        frames: isolated targets with their true T_sensor_target (4, 4), as many as a scan fuses.
        settings: of the fusion.
    """
    if not frames:
        return ScanResult(NO_TARGET, None)
    # A scan's target frame has the first frame's attitude. In a simulated target's own frame the faces are
    # parallel to the voxels' axes, and thin plates fuse differently than in any scan.
    R_first = frames[0][1][:3, :3]
    T_target_new = transform(R_first.T, np.zeros(3))
    poses = [(frame, compose(T, T_target_new)) for frame, T in frames]
    surface = fuse([(frame, inverse(T)) for frame, T in poses], settings.fusion)
    if surface is None:
        return ScanResult(NO_TARGET, None)
    model, shift = make_model(surface, [], None)
    T_new_model = transform(np.eye(3), shift)
    stamped = [StampedPose(frame.stamp_ns, compose(T, T_new_model)) for frame, T in poses]
    return ScanResult(None, model, poses=stamped, odometry=stamped)


def true_pose_attitude(
    result: ScanResult, frames: Sequence[tuple[TargetFrame, Array]]
) -> dict[str, float] | None:
    """Attitude error, degrees, of single frames registered to the model of the true poses.

    The effect of one frame's noise on its attitude, for any estimator. Partially occluded frames are left
    out.

    Args:
        result: of :func:`true_pose_result`.
        frames: from which it was made.
    """
    if result.model is None:
        return None
    surface = tracking_surface(result.model, POINTS)
    pixels = np.array([np.count_nonzero(frame.depth) for frame, _ in frames])
    errors = []
    for n in np.flatnonzero(pixels >= UNOCCLUDED * np.median(pixels)).tolist():
        T_sensor_target = result.poses[n].T_sensor_target
        T_target_view = _registered(surface, View(frames[n][0]), inverse(T_sensor_target))
        errors.append(np.degrees(rotation_angle((T_sensor_target @ T_target_view)[:3, :3])))
    return {'median': round(float(np.median(errors)), 4)}


def _registered(surface: Surface, view: View, T_target_view: Array) -> Array:
    """Pose (4, 4) of a view after registration to the surface alone."""
    for gate in GATES:
        lin = linearise(surface, np.eye(4), view, T_target_view, gate)
        # the twist moves the surface; the view moves the other way
        T_target_view = compose(exp_se3(-solve_step(lin.H, lin.g)), T_target_view)
    return T_target_view
