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

"""A target out of sight for too long before there was a model: the nodes join what belongs together."""

import dataclasses

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Empty

from debris_scanner.core.geometry import inverse
from debris_scanner.evaluation.trajectory_errors import align, pose_errors
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.stage import RESET_TOPIC
from debris_scanner.nodes.publishing.estimates import read_status
from msg_adapters.poses import read_path
from msg_adapters.target_frames import target_frame_message

pytestmark = pytest.mark.ros  # each frame waits for the one before: it may run beside others

SENSOR = 'camera_depth_optical_frame'
GAP_NS = 30_000_000_000


def test_two_parts_of_a_turn_become_one_model(nodes, peer, coarse_recording):
    recording = coarse_recording
    resets = peer.listen(Empty, RESET_TOPIC)
    statuses = peer.listen(DiagnosticArray, 'odometry_status')
    models = peer.listen(PointCloud2, 'model', qos.latched())
    paths = peer.listen(Path, 'keyframe_poses', qos.latched())
    for node in ('odometry', 'closure', 'graph'):
        nodes.start(node)
    peer.until(lambda: {'odometry', 'closure', 'graph'} <= set(peer.reports), 'reports of all three')
    points = peer.talk(PointCloud2, 'target_points')
    assert points.get_subscription_count() == 2  # odometry and graph
    later = [dataclasses.replace(t, stamp_ns=t.stamp_ns + GAP_NS) for t in recording.targets[45:115:2]]
    jump = [
        target.stamp_ns for target in later[:2]
    ]  # nothing passes on the clock: the third in a row shows that time has gone on
    count = 0
    for target in [*recording.targets[:70:2], *later]:
        points.publish(target_frame_message(target, SENSOR))
        count += target.stamp_ns not in jump
        peer.until(lambda: len(statuses) == count, f'status {count}')
    read = [read_status(s) for s in statuses]
    assert {s.scan_ns for s in read} == {recording.targets[0].stamp_ns}
    assert sorted({s.submap for s in read}) == [0, 1]
    assert not resets
    peer.until(lambda: models and paths, 'the model', 150.0)

    poses = {stamp: inverse(T) for stamp, T in read_path(paths[-1])}
    assert min(poses) < GAP_NS / 2 < max(poses)
    truth = dict(recording.truth) | {stamp + GAP_NS: T for stamp, T in recording.truth.items()}
    attitude, _ = pose_errors(truth, poses, align(truth, poses))
    assert np.degrees(attitude.max()) < 1.0
    nodes.check()
    nodes._children['graph'].process.kill()  # it would make the model once more, for half of the test's time
