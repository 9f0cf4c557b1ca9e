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

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker

from debris_scanner.core.geometry import transform
from msg_adapters.errors import MalformedMessage
from msg_adapters.markers import graph_markers, read_graph


def positions(marker: Marker) -> list[tuple[float, float, float]]:
    return [(p.x, p.y, p.z) for p in marker.points]


def test_the_graph_is_drawn_where_the_sensor_stood():
    keyframes = [transform(np.eye(3), np.array([float(i), 0, 0.5])) for i in range(4)]
    nodes, edges, closures = graph_markers(3, 'target', keyframes, [(0, 1), (1, 2), (2, 3)], [(0, 3)]).markers
    assert nodes.type == Marker.SPHERE_LIST
    assert positions(nodes) == [(float(i), 0, 0.5) for i in range(4)]
    assert edges.type == closures.type == Marker.LINE_LIST
    assert [x for x, _, _ in positions(edges)] == [0, 1, 1, 2, 2, 3]
    assert [x for x, _, _ in positions(closures)] == [0, 3]
    assert edges.color != closures.color
    for marker in (nodes, edges, closures):
        assert marker.header.frame_id == 'target'
        assert marker.pose.orientation.w == 1
        assert marker.scale.x > 0 and marker.color.a == 1


def test_a_new_graph_replaces_all_of_the_old_one():
    full = graph_markers(0, 'target', [np.eye(4)] * 3, [(0, 1)], [(0, 2)])
    empty = graph_markers(1, 'target', [], [], [])
    assert [(m.ns, m.id) for m in full.markers] == [(m.ns, m.id) for m in empty.markers]
    assert not any(m.points for m in empty.markers)
    assert serialize_message(empty)


def test_the_graph_comes_back():
    keyframes = [transform(np.eye(3), np.array([float(i), 0, 0.5])) for i in range(4)]
    frame, nodes, edges, closures = read_graph(
        graph_markers(3, 'target', keyframes, [(0, 1), (1, 2)], [(0, 3)])
    )
    assert frame == 'target'
    assert nodes.tolist() == [[float(i), 0, 0.5] for i in range(4)]
    assert edges[..., 0].tolist() == [[0, 1], [1, 2]]
    assert closures[..., 0].tolist() == [[0, 3]]
    frame, *parts = read_graph(graph_markers(0, 'target_scanning', [], [], []))
    assert frame == 'target_scanning'
    assert [part.shape for part in parts] == [(0, 3), (0, 2, 3), (0, 2, 3)]


def spoilt(change):
    array = graph_markers(0, 'target', [np.eye(4)] * 2, [(0, 1)], [(0, 1)])
    change(array.markers)
    return array


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        (lambda markers: markers.pop(), "graph without markers ['closures']"),
        (lambda markers: markers[1].points.pop(), 'lines without an end'),
        (lambda markers: setattr(markers[0].points[0], 'x', float('nan')), 'not finite'),
        (lambda markers: setattr(markers[0].points[0], 'x', 1e300), 'not finite'),
    ],
)
def test_what_is_no_graph_is_malformed(change, said):
    with pytest.raises(MalformedMessage) as refusal:
        read_graph(spoilt(change))
    assert said in str(refusal.value)
