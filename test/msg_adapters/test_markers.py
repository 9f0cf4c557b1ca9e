import numpy as np
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker

from debris_scanner.geometry import transform
from msg_adapters.markers import graph_markers


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
