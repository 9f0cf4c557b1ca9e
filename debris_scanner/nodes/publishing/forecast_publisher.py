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

"""Topics of the forecast while a model is tracked: ``forecast`` and ``forecast_states``, once a second."""

import threading
import time

import numpy as np
from nav_msgs.msg import Path
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.geometry import inverse, to_quaternion
from debris_scanner.core.results import Forecast, StampedPose
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.tracking.forecast import Forecaster
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.clouds import cloud_message
from msg_adapters.poses import path_message

EVERY_S = 1.0


class ForecastPublisher:
    """Fits and publishes in a thread of its own, once a second of frames."""

    def __init__(self, node: Node, sensor_path: SensorPath, mean_motion: float) -> None:
        self._path = node.create_publisher(Path, 'forecast', qos.waiting())
        self._states = node.create_publisher(PointCloud2, 'forecast_states', qos.waiting())
        self._forecaster = Forecaster(sensor_path, mean_motion)
        self._model: object = None
        self._due_s = 0.0  # time.monotonic()
        self._thread: threading.Thread | None = None
        self._node = node

    def note(self, estimate: OdometryEstimate, source: Odometry, frame_id: str) -> None:
        """Take up the estimate of a frame; publish if it is time.

        Args:
            estimate: of the frame.
            source: the odometry that made it, right after the frame.
            frame_id: of the sensor.
        """
        model = source.model
        if model is not self._model:
            self._model = model
            if model is not None:
                known = [StampedPose(k.stamp_ns, inverse(k.T_target_sensor)) for k in source.keyframes.frames]
                self._forecaster.begin(known, float(np.ptp(model.points, axis=0).max()))
        if model is None or not estimate.tracked:
            return
        if estimate.accepted:
            sigma = float(np.sqrt(np.trace(estimate.covariance[:3, :3]) / 3))
            self._forecaster.add(StampedPose(estimate.stamp_ns, estimate.T_sensor_target), sigma)
        now_s = time.monotonic()
        if now_s >= self._due_s and (self._thread is None or not self._thread.is_alive()):
            self._due_s = now_s + EVERY_S
            self._thread = threading.Thread(
                target=self._publish, args=(estimate.stamp_ns, frame_id), name='forecast', daemon=True
            )
            self._thread.start()

    def _publish(self, stamp_ns: int, frame_id: str) -> None:
        try:
            self._forecaster.update()
            prediction = self._forecaster.prediction
            if prediction is None:
                return
            forecast = prediction.ahead(stamp_ns)
            poses = list(zip(forecast.stamps_ns, forecast.poses, strict=True))
            self._path.publish(path_message(stamp_ns, frame_id, poses))
            self._states.publish(states_message(stamp_ns, frame_id, forecast))
        except Exception as error:  # a forecast is not worth a scan
            if self._node.context.ok():
                self._node.get_logger().warning(f'no forecast: {error}', throttle_duration_sec=10.0)


def states_message(stamp_ns: int, frame_id: str, forecast: Forecast) -> PointCloud2:
    """A point a step: x, y, z of the target, and by name all else that ``forecast.csv`` has."""
    columns = {'seconds': [(s - stamp_ns) * 1e-9 for s in forecast.stamps_ns]}
    columns |= dict(zip('xyz', forecast.poses[:, :3, 3].T, strict=True))
    quaternions = np.array([to_quaternion(T[:3, :3]) for T in forecast.poses])
    columns |= {f'q{axis}': q for axis, q in zip('xyzw', quaternions.T, strict=True)}
    for name, values in (
        ('omega', forecast.rates),
        ('sigma_position', forecast.position_sigma),
        ('sigma_attitude', forecast.attitude_sigma),
        ('sigma_omega', forecast.rate_sigma),
    ):
        columns |= {f'{name}_{axis}': v for axis, v in zip('xyz', values.T, strict=True)}
    return cloud_message(stamp_ns, frame_id, {k: np.asarray(v, np.float32) for k, v in columns.items()})
