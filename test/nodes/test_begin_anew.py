"""A target that was out of sight for too long before there was a model: every stage begins a new scan."""

import dataclasses

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Empty

from debris_scanner.nodes.estimates import read_verdict
from debris_scanner.nodes.stage import RESET_TOPIC
from msg_adapters.target_frames import target_frame_message

pytestmark = pytest.mark.ros

SENSOR = 'camera_depth_optical_frame'
GAP_NS = 30_000_000_000


def test_the_odometry_asks_once_for_a_new_scan_and_begins_it(nodes, peer, recording):
    resets = peer.listen(Empty, RESET_TOPIC)
    verdicts = peer.listen(DiagnosticArray, 'odometry_status')
    nodes.start('odometry')
    points = peer.talk(PointCloud2, 'target_points')
    for target in recording.targets[:15]:
        points.publish(target_frame_message(target, SENSOR))
    peer.until(lambda: len(verdicts) == 15, 'fifteen verdicts')
    later = [
        dataclasses.replace(
            recording.targets[60 + n % 6], stamp_ns=recording.targets[15 + n].stamp_ns + GAP_NS
        )
        for n in range(40)
    ]
    sent = iter(later)

    def begun():
        if (target := next(sent, None)) is not None:
            points.publish(target_frame_message(target, SENSOR))
        scans = {read_verdict(v).scan_ns for v in verdicts}
        return len(scans) > 1

    peer.until(begun, 'a verdict of another scan')
    assert len(resets) == 1
    first = read_verdict(verdicts[-1])
    assert first.accepted
    assert first.scan_ns > recording.targets[14].stamp_ns + GAP_NS / 2
    nodes.check()
