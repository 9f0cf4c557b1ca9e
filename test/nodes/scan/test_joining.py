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

"""Messages of frames and closures are joined, and those of different scans are distinguished."""

import time

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.results import ClosureRecord
from debris_scanner.nodes.publishing.estimates import FrameStatus
from debris_scanner.nodes.scan import joining
from debris_scanner.nodes.scan.joining import (
    NEW,
    PATIENCE_S,
    SAME,
    STALE,
    ClosureJoin,
    FrameJoin,
    ScanIdentity,
)
from msg_adapters.poses import ClosureTransform
from msg_adapters.stamps import header_message


def status(stamp, accepted=True, keyframe=False):
    return FrameStatus(stamp, 1, 'scanning', accepted, keyframe, False, 0.0)


def odometry(stamp):
    return Odometry(header=header_message(stamp, 'sensor'))


def cloud(stamp):
    return PointCloud2(header=header_message(stamp, 'sensor'))


def transform(first, second):
    """An accepted closure between two key frames."""
    T = np.eye(4)
    T[:3, 3] = first, second, 0.5
    return ClosureTransform(first, second, T)


def record(first, second, probability=0.9):
    """The evidence of an accepted closure."""
    return ClosureRecord(first, second, probability, True, 'overlap 0.9')


class TestFrameJoin:
    def join(self):
        return FrameJoin(lambda v: v.accepted)

    def test_a_cloud_that_was_dropped_is_not_waited_for_but_a_key_frames(self):
        join = self.join()
        for stamp in (5, 6, 7):
            join.add_status(status(stamp, keyframe=stamp == 6), 0.0)
            join.add_odometry(odometry(stamp))
            join.drop_cloud(stamp)
        (first,) = join.pop(0.1)
        assert (first.status.stamp_ns, first.cloud, first.dropped) == (5, None, True)
        join.add_cloud(cloud(6))  # from the topic of key frames
        second, third = join.pop(0.2)
        assert second.cloud is not None
        assert (third.status.stamp_ns, third.cloud) == (7, None)

    @pytest.mark.parametrize('order', [(0, 1, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)])
    def test_messages_come_in_any_order(self, order):
        join = self.join()
        add = [
            lambda: join.add_status(status(5), 0.0),
            lambda: join.add_odometry(odometry(5)),
            lambda: join.add_cloud(cloud(5)),
        ]
        for k in order[:-1]:
            add[k]()
            assert not list(join.pop(0.1))
        add[order[-1]]()
        (joined,) = join.pop(0.1)
        assert joined.status.stamp_ns == 5
        assert joined.odometry is not None
        assert joined.cloud is not None
        assert len(join) == 0

    def test_frames_leave_in_order_and_an_unwanted_cloud_is_not_waited_for(self):
        join = self.join()
        for stamp, accepted in ((5, True), (6, False), (7, True)):
            join.add_status(status(stamp, accepted), 0.0)
            join.add_odometry(odometry(stamp))
        join.add_cloud(cloud(7))
        assert not list(join.pop(0.1))
        join.add_cloud(cloud(5))
        assert [f.status.stamp_ns for f in join.pop(0.1)] == [5, 6, 7]

    def test_a_new_scan_keeps_the_messages_that_came_before_its_first_status(self):
        join = self.join()
        join.add_status(status(5), 0.0)
        join.add_odometry(odometry(6))
        join.add_cloud(cloud(6))
        join.restart()
        join.add_status(status(6), 0.1)
        (joined,) = join.pop(0.1)
        assert (joined.status.stamp_ns, joined.cloud is not None) == (6, True)

    def test_what_never_comes_is_given_up(self):
        join = self.join()
        join.add_status(status(5), 0.0)
        join.add_odometry(odometry(5))
        assert not list(join.pop(PATIENCE_S - 0.1))
        (joined,) = join.pop(PATIENCE_S + 0.1)
        assert joined.cloud is None
        join.add_cloud(cloud(5))  # too late, and not kept for ever
        join.add_status(status(6), 9.0)
        join.add_odometry(odometry(6))
        join.add_cloud(cloud(6))
        list(join.pop(9.0))
        assert not join._clouds

    def test_what_may_still_be_in_a_queue_is_waited_for(self):
        join = FrameJoin(lambda v: v.accepted)
        join.add_status(status(6), 9.0)
        assert list(join.pop(15.0, patience_s=20.0)) == []
        join.add_odometry(odometry(6))
        join.add_cloud(cloud(6))
        (joined,) = join.pop(15.0, patience_s=20.0)
        assert joined.odometry is not None
        assert joined.cloud is not None


class TestScanIdentity:
    def test_a_reset_and_what_is_still_on_its_way(self):
        identity = ScanIdentity()
        assert [identity.of(10), identity.of(10)] == [NEW, SAME]
        assert identity.reset()
        assert identity.of(10) == STALE
        assert [identity.of(20), identity.of(10), identity.of(20)] == [NEW, STALE, SAME]

    def test_the_new_scan_overtakes_its_reset(self):
        identity = ScanIdentity()
        identity.of(10)
        assert identity.of(20) == NEW
        assert not identity.reset(), 'the scan that the reset asked for would be thrown away'
        assert [identity.of(20), identity.of(10)] == [SAME, STALE]

    def test_a_later_reset_counts(self, monkeypatch):
        identity = ScanIdentity()
        identity.of(10)
        identity.of(20)
        now = time.monotonic()
        monkeypatch.setattr(joining.time, 'monotonic', lambda: now + 10)
        assert identity.reset()
        assert identity.of(20) == STALE


class TestClosureJoin:
    @pytest.fixture
    def dropped(self):
        """Texts of the closures that the join has dropped."""
        return []

    @pytest.fixture
    def join(self, dropped):
        return ClosureJoin(dropped.append)

    def test_evidence_and_closure_come_in_any_order(self, join, dropped):
        join.add_records([record(1, 9)])
        join.add(transform(1, 9), 0.0)
        join.add(transform(2, 9), 0.5)
        assert [(c.from_stamp_ns, since) for c, since in join.pop({1, 2, 9}, 0.6)] == [(1, 0.0)]
        assert not list(join.pop({1, 2, 9}, 0.7))
        assert len(join) == 1
        join.add_records([record(2, 9, 0.75)])
        ((closure, since_s),) = join.pop({1, 2, 9}, 0.8)
        assert (closure.from_stamp_ns, closure.to_stamp_ns, since_s) == (2, 9, 0.5)
        assert (closure.probability, closure.accepted, closure.why) == (0.75, True, 'overlap 0.9')
        np.testing.assert_array_equal(closure.T_from_to, transform(2, 9).T_from_to)
        assert len(join) == 0
        assert dropped == []

    def test_complete_ones_leave_in_order_of_arrival(self, join):
        pairs = [(3, 9), (1, 9), (2, 8)]
        join.add_records([record(*pair) for pair in reversed(pairs)])
        for k, pair in enumerate(pairs):
            join.add(transform(*pair), 0.1 * k)
        left = [(c.from_stamp_ns, c.to_stamp_ns) for c, _ in join.pop({1, 2, 3, 8, 9}, 0.5)]
        assert left == pairs

    def test_key_frames_are_waited_for(self, join, dropped):
        join.add_records([record(1, 9)])
        join.add(transform(1, 9), 0.0)
        assert not list(join.pop({1}, 1.0))
        assert not list(join.pop({9}, PATIENCE_S - 0.1))
        ((closure, _),) = join.pop({1, 9}, PATIENCE_S + 5.0)  # not dropped: now it is complete
        assert closure.to_stamp_ns == 9
        assert dropped == []

    def test_one_of_an_unknown_key_frame_is_dropped_with_a_text(self, join, dropped):
        join.add_records([record(1, 9)])
        join.add(transform(1, 9), 0.0)
        assert not list(join.pop({1}, PATIENCE_S + 0.1))
        assert dropped == ['closure 1 - 9 names an unknown key frame']
        assert len(join) == 0
        assert not list(join.pop({1, 9}, PATIENCE_S + 0.2))

    def test_a_busy_node_waits_for_longer(self, join, dropped):
        join.add(transform(1, 9), 0.0)
        assert not list(join.pop({1}, PATIENCE_S + 1.0, patience_s=20.0))
        assert len(join) == 1
        assert dropped == []

    def test_evidence_that_never_comes_is_not_required(self, join, dropped):
        """Another node may publish closures without candidates."""
        join.add(transform(1, 9), 0.0)
        ((closure, _),) = join.pop({1, 9}, PATIENCE_S + 0.1)
        assert (closure.probability, closure.why) == (1.0, 'from another node')
        assert dropped == []

    def test_only_new_hypotheses_are_returned(self, join):
        first = [record(1, 9), record(2, 9)]
        assert join.add_records(first) == first
        assert join.add_records([record(2, 9, 0.5), record(3, 9)]) == [record(3, 9)]
        assert join.add_records([record(4, 9, 0.1), record(4, 9, 0.2)]) == [record(4, 9, 0.2)]

    def test_the_number_of_hypotheses_is_bounded(self, join, monkeypatch):
        monkeypatch.setattr(joining, 'MOST_HYPOTHESES', 3)
        assert len(join.add_records([record(k, 9) for k in range(1, 3)])) == 2
        assert join.add_records([record(k, 9) for k in range(3, 6)]) == [record(3, 9)]
        assert join.add_records([record(6, 9)]) == []

    def test_a_new_scan_forgets_all(self, join, dropped):
        join.add_records([record(1, 9)])
        join.add(transform(1, 9), 0.0)
        join.restart()
        assert len(join) == 0
        assert not list(join.pop({1, 9}, 9.0))
        assert join.add_records([record(1, 9)]) == [record(1, 9)]
        assert dropped == []
