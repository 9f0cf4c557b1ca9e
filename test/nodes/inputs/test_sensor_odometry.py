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

"""The sensor's odometry arrives over DDS; what is damaged is left out."""

import numpy as np
from nav_msgs.msg import Odometry

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.nodes.inputs.sensor_odometry import TOPIC, follow_sensor
from debris_scanner.tracking.sensor_path import ODOMETRY, SensorPath
from msg_adapters.poses import odometry_message

OMEGA, SIGMA = np.array([0.1, -0.2, 0.3]), 1e-4


def sample(t):
    T, zeros = transform(exp_so3(OMEGA * t), np.array([t, 0.0, 0.0])), np.zeros((6, 6))
    covariance = SIGMA**2 * np.eye(6)
    return odometry_message(round((t + 5) * 1e9), 'world', 'camera', T, covariance, zeros[0], zeros)


def test_poses_are_placed_by_what_was_received(peer):
    path = SensorPath()
    follow_sensor(peer.node, path)
    publisher = peer.talk(Odometry, TOPIC)
    damaged = sample(0.05)
    damaged.pose.pose.position.x = float('nan')
    for msg in (sample(0.0), damaged, sample(0.1)):
        publisher.publish(msg)
    pose = [StampedPose(5_050_000_000, np.eye(4))]
    peer.until(lambda: path.place(pose).frame == ODOMETRY, 'the odometry')
    placed = path.place(pose)
    expected = transform(exp_so3(0.05 * OMEGA), np.array([0.05, 0.0, 0.0]))
    np.testing.assert_allclose(placed.poses[0].T_sensor_target, expected, atol=1e-9)
    np.testing.assert_allclose(placed.sigma_rad, SIGMA)
