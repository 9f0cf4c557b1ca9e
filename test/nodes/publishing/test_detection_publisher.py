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

"""Detection3D of the tracked target, with messages as vision_msgs has them: no wheel of it is on PyPI."""

from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Pose, Vector3

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import exp_se3
from debris_scanner.nodes.publishing import detection_publisher
from debris_scanner.nodes.publishing.detection_publisher import DetectionPublisher, box_of
from msg_adapters.poses import read_pose, target_pose_message

POINTS = np.float32([[-0.1, 0, 0], [0.3, 0.2, 0.1], [0.1, 0.1, 0.5]])
MODEL = Model(POINTS, np.zeros((3, 3), np.float32), POINTS, np.zeros((0, 3), np.int32))


class Detection3D:
    def __init__(self, header, id):
        self.header, self.id, self.results = header, id, []
        self.bbox = SimpleNamespace(center=Pose(), size=Vector3())


class ObjectHypothesisWithPose:
    def __init__(self, pose):
        self.pose, self.hypothesis = pose, SimpleNamespace(class_id='', score=0.0)


class Node:
    def __init__(self):
        self.sent = []

    def create_publisher(self, kind, topic, profile):
        assert (kind, topic) == (Detection3D, 'detection')
        return SimpleNamespace(publish=self.sent.append)


@pytest.fixture
def pose():
    return target_pose_message(5, 'camera', exp_se3(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])), np.eye(6))


def test_the_box_lies_about_the_model(monkeypatch, pose):
    messages = SimpleNamespace(Detection3D=Detection3D, ObjectHypothesisWithPose=ObjectHypothesisWithPose)
    monkeypatch.setattr(detection_publisher, 'vision_msgs', messages)
    node = Node()
    DetectionPublisher(node).send(pose, MODEL, 'left/target')
    (sent,) = node.sent
    assert (sent.id, sent.header.frame_id, sent.results[0].pose) == ('left/target', 'camera', pose.pose)
    size = sent.bbox.size
    np.testing.assert_allclose((size.x, size.y, size.z), (0.4, 0.2, 0.5), atol=1e-6)
    T = read_pose(pose.pose.pose)
    centre, _ = box_of(MODEL)
    np.testing.assert_allclose(read_pose(sent.bbox.center)[:3, 3], T[:3, :3] @ centre + T[:3, 3], atol=1e-6)


def test_without_vision_msgs_nothing_is_published(monkeypatch, pose):
    monkeypatch.setattr(detection_publisher, 'vision_msgs', None)
    node = Node()
    DetectionPublisher(node).send(pose, MODEL, 'target')
    assert node.sent == []
