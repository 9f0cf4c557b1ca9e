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

"""A hostile publisher on the domain: damaged messages on every topic that a node subscribes to."""

import copy
import sys
from pathlib import Path
from random import Random

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import TOPIC

sys.path.append(str(Path(__file__).parents[1] / 'fuzz'))
import mutations
from message_cases import seeds
from mutations import damaged, disturb

pytestmark = pytest.mark.ros

mutations.PLENTY = 50  # longer lists: see run_fuzz.py; a thousand messages may wait in the middleware
STAGES = ('preprocess', 'odometry', 'closure', 'graph')
MESSAGES = 1200
LATCHED = ('model', 'keyframe_poses', 'depth_offset')
# topic, type, what is sent there, and which of the messages of that kind
TOPICS = (
    ('points', PointCloud2, 'cloud', 0),
    ('depth/image_raw', Image, 'depth_16UC1', 0),
    ('depth/camera_info', CameraInfo, 'depth_16UC1', 1),
    ('target_points', PointCloud2, 'target', 0),
    ('keyframe_points', PointCloud2, 'target', 0),
    ('odometry', Odometry, 'odometry', 0),
    ('odometry_status', DiagnosticArray, 'status', 0),
    ('closure_candidates', DiagnosticArray, 'candidates', 0),
    ('closures', TransformStamped, 'closure', 0),
    ('model', PointCloud2, 'model', 0),
    ('keyframe_poses', PathMessage, 'path', 0),
    ('depth_offset', PointCloud2, 'offset', 0),
    (TOPIC, DiagnosticArray, 'report', 0),
)


def sent(publisher, message, random):
    """Every third message is whole, a third has wild fields, a third wild bytes."""
    choice = random.randrange(3)
    stamp_ns = 10**18 + random.randrange(10**9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    if choice == 0:
        publisher.publish(damaged(serialize_message(message), random))
        return
    if choice == 1:
        disturb(message, random)
    publisher.publish(message)


def test_no_node_falls(nodes, peer, tmp_path):
    folder = tmp_path / 'out'
    for stage in STAGES:
        given = ['-p', f'output_dir:={folder}'] if stage == 'graph' else []
        nodes.start(stage, ['--ros-args', '-p', 'input_reliability:=reliable', *given])
    peer.until(lambda: set(peer.reports) >= set(STAGES), 'all nodes')
    publishers = [
        peer.node.create_publisher(kind, topic, qos.latched() if topic in LATCHED else qos.waiting())
        for topic, kind, *_ in TOPICS
    ]
    processes = [psutil.Process(nodes._children[stage].process.pid) for stage in STAGES]
    before = {p.pid: p.memory_info().rss for p in processes}
    random, count = Random(5), 0
    with np.errstate(all='ignore'):
        while count < MESSAGES:
            for publisher, (_, _, kind, which) in zip(publishers, TOPICS, strict=True):
                sent(publisher, copy.deepcopy(seeds()[kind][0][which]), random)
                count += 1
            peer.executor.spin_once(0.02)
            nodes.check()
    peer.reports.clear()
    peer.until(lambda: set(peer.reports) >= set(STAGES), 'all nodes afterwards')
    nodes.check()
    grown = {s: (p.memory_info().rss - before[p.pid]) / 1e6 for s, p in zip(STAGES, processes, strict=True)}
    assert max(grown.values()) < 300, grown
    assert not [p for p in tmp_path.rglob('*') if 'passwd' in p.name]
    logs = ''.join(path.read_text(errors='replace') for path in (tmp_path / 'logs').glob('*.log'))
    assert 'Traceback' not in logs
