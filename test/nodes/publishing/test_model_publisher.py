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

"""The messages of a model: TF places them whenever they arrive, and odometry knows whose poses it gets."""

import numpy as np
import pytest
from nav_msgs.msg import Path
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.frames import Model
from debris_scanner.modelling.generation import Generation
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.publishing.model_publisher import ModelPublisher
from debris_scanner.sensing.depth_offset import DepthOffset
from msg_adapters.models import fingerprint, read_depth_offset
from msg_adapters.poses import read_path, transform_message
from msg_adapters.stamps import read_stamp

pytestmark = pytest.mark.ros
SENSOR, SECOND_NS = 'camera_depth_optical_frame', 10**9
TOPICS = {
    'model': PointCloud2,
    'model_mesh': Marker,
    'keyframe_poses': Path,
    'depth_offset': PointCloud2,
    'graph_markers': MarkerArray,
}
OFFSET = DepthOffset(0.05, (-3, 2), 1e-3 * np.arange(40.0).reshape(5, 8))


def generation(scale):
    points = scale * np.random.default_rng(0).random((30, 3)).astype(np.float32)
    model = Model(points, points, points, np.arange(30, dtype=np.int32).reshape(-1, 3))
    poses = {k * SECOND_NS: np.eye(4) for k in range(1, 5)}
    return Generation(model, None, '', poses, None, offset=OFFSET)


@pytest.fixture
def shown(peer):
    """Publishes something; the last message on every topic, as who comes later gets it."""
    publisher = ModelPublisher(peer.node)

    def show(publish):
        publish(publisher)
        heard = {topic: peer.listen(kind, topic, qos.latched()) for topic, kind in TOPICS.items()}
        peer.until(lambda: all(heard.values()), 'every topic')
        return {topic: messages[-1] for topic, messages in heard.items()}

    return show


def displayed(shown):
    return [shown['model'], shown['model_mesh'], *shown['graph_markers'].markers]


def test_what_does_not_move_in_its_frame_has_no_time_and_markers_move_along(shown):
    messages = displayed(shown(lambda p: p.publish(generation(1.0))))
    assert {read_stamp(m.header.stamp) for m in messages} == {0}
    assert {m.header.frame_id for m in messages} == {'target'}
    assert all(m.frame_locked for m in messages[1:])


def test_tf_places_it_long_after_the_last_key_frame(shown):
    tf2_ros = pytest.importorskip('tf2_ros')
    messages = displayed(shown(lambda p: p.publish(generation(1.0))))
    buffer = tf2_ros.Buffer()  # of an RViz that has come later: it knows the target from 60 s on
    for second in range(60, 65):
        T = np.eye(4)
        T[2, 3] = second
        buffer.set_transform(transform_message(second * SECOND_NS, SENSOR, 'target', T), 'test')
    with pytest.raises(tf2_ros.ExtrapolationException):
        buffer.lookup_transform(SENSOR, 'target', Time(seconds=4))
    for message in messages:
        placed = buffer.lookup_transform(SENSOR, message.header.frame_id, Time.from_msg(message.header.stamp))
        assert placed.transform.translation.z == 64


def test_the_offset_names_its_model(shown):
    first = shown(lambda p: p.publish(generation(1.0)))
    assert read_stamp(first['depth_offset'].header.stamp) == fingerprint(first['model'])
    np.testing.assert_allclose(read_depth_offset(first['depth_offset']).coefficients, OFFSET.coefficients)
    assert read_depth_offset(shown(lambda p: p.clear())['depth_offset']).is_none


def test_the_poses_name_their_model(shown):
    first = shown(lambda p: p.publish(generation(1.0)))
    assert [stamp for stamp, _ in read_path(first['keyframe_poses'])] == [k * SECOND_NS for k in range(1, 5)]
    assert read_stamp(first['keyframe_poses'].header.stamp) == fingerprint(first['model']) != 0
    cleared = shown(lambda p: p.clear())
    assert read_stamp(cleared['keyframe_poses'].header.stamp) == fingerprint(cleared['model']) == 0
    second = shown(lambda p: p.publish(generation(1.5)))
    assert fingerprint(second['model']) == read_stamp(second['keyframe_poses'].header.stamp)
    assert fingerprint(second['model']) != fingerprint(first['model'])
