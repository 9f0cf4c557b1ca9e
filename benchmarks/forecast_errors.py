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

"""Mass properties and forecast of a simulated scan, judged by the motion that goes on after its end."""

from typing import Any

import numpy as np

from benchmarks.scorecard.recordings import SimulatedRecording
from debris_scanner.core.geometry import Array, compose, exp_so3, log_so3, rotation_angle
from debris_scanner.evaluation.trajectory_errors import Poses, align, by_stamp
from debris_scanner.io.result_files import ScanResult

AHEAD_S = (10, 30, 60)
_STEP_NS = 10_000_000  # for a true rate


def forecast_figures(
    result: ScanResult, truth: Poses, recording: SimulatedRecording
) -> dict[str, Any] | None:
    """Errors of what was forecast and of the mass properties; None of a scan without a forecast.

    ``nees``: squared attitude error over its covariance, of three degrees of freedom. ``constant_rate_deg``:
    error of the last rate kept on. The true inertia is that of the simulator's tumbles.

    Args:
        result: of the scan.
        truth: true T_sensor_target by stamp.
        recording: knows the target's pose after the last frame.
    """
    forecast, told = result.forecast, result.mass_properties
    if forecast is None or told is None:
        return None
    T_truth_target = align(truth, by_stamp(result.poses))
    last, before = result.poses[-1], result.poses[-4]
    turn = log_so3(before.T_sensor_target[:3, :3].T @ last.T_sensor_target[:3, :3])
    omega = turn / ((last.stamp_ns - before.stamp_ns) * 1e-9)
    ahead = []
    for seconds in AHEAD_S:
        k = seconds - 1
        T = compose(recording.pose_at(forecast.stamps_ns[k]), T_truth_target)
        error = log_so3(forecast.poses[k][:3, :3].T @ T[:3, :3])
        constant = last.T_sensor_target[:3, :3] @ exp_so3(seconds * omega)
        ahead.append(
            {
                'seconds': seconds,
                'attitude_deg': _degrees(np.linalg.norm(error)),
                'attitude_sigma_deg': _degrees(np.linalg.norm(forecast.attitude_sigma[k])),
                'nees': round(float(np.sum((error / forecast.attitude_sigma[k]) ** 2)), 3),
                'position_mm': round(1e3 * float(np.linalg.norm(T[:3, 3] - forecast.poses[k][:3, 3])), 3),
                'constant_rate_deg': _degrees(rotation_angle(constant.T @ T[:3, :3])),
            }
        )
    figures = {'why': told['why'], 'ahead': ahead}
    return figures | (_mass_errors(told, T_truth_target, recording, result) if told['observable'] else {})


def _mass_errors(
    told: dict[str, Any], T_truth_target: Array, recording: SimulatedRecording, result: ScanResult
) -> dict[str, Any]:
    """Errors of the mass properties of a torque-free target."""
    moments = np.asarray(recording.inertia, np.float64)
    order = np.argsort(moments)
    ratios = moments[order][:2] / moments[order][2]
    R = T_truth_target[:3, :3]
    found = R @ np.array(told['principal_axes']).T  # columns, in the true target frame
    cosines = np.abs(np.einsum('ik,ik->k', found, np.eye(3)[:, order]))
    centre = T_truth_target @ np.append(told['centre_of_mass_m'], 1.0)
    at_ns = result.poses[-1].stamp_ns
    here, later = recording.pose_at(at_ns), recording.pose_at(at_ns + _STEP_NS)
    true_momentum = here[:3, :3] @ (moments * log_so3(here[:3, :3].T @ later[:3, :3]))
    momentum = np.array(told['angular_momentum_sensor'])
    cosine = momentum @ true_momentum / np.linalg.norm(momentum) / np.linalg.norm(true_momentum)
    return {
        'ratio_errors': (np.array(told['inertia_ratios']) / ratios - 1).round(6).tolist(),
        'ratio_sigmas': (np.array(told['inertia_ratios_sigma']) / ratios).round(6).tolist(),
        'axes_deg': _degrees(np.arccos(np.minimum(cosines, 1.0)).max()),
        'momentum_deg': _degrees(np.arccos(min(1.0, float(cosine)))),
        'centre_mm': round(1e3 * float(np.linalg.norm(centre[:3] - recording.centre_of_mass)), 3),
    }


def _degrees(angle: Any) -> float:
    return round(float(np.degrees(angle)), 4)
