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

"""Frames put together, counted and timed; work done in order; things sent when they are due."""

import struct
import threading
import time

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.camera import Camera
from debris_scanner.core.stamps import SensorClock, replay_values
from debris_scanner.nodes.inputs.sources import Due, Pacer, wait_for
from debris_scanner.nodes.lifecycle.worker import Worker
from debris_scanner.nodes.play_bag import restamped
from debris_scanner.nodes.publishing.estimates import FrameStatus
from debris_scanner.nodes.scan import joining as scan_identity
from debris_scanner.nodes.scan.joining import NEW, PATIENCE_S, SAME, STALE, FrameJoin, ScanIdentity
from msg_adapters.depth_images import camera_info_message
from msg_adapters.stamps import header_message, read_stamp


def status(stamp, accepted=True, keyframe=False):
    return FrameStatus(stamp, 1, 'scanning', accepted, keyframe, False, 0.0)


def odometry(stamp):
    return Odometry(header=header_message(stamp, 'sensor'))


def cloud(stamp):
    return PointCloud2(header=header_message(stamp, 'sensor'))


class TestJoin:
    def join(self):
        return FrameJoin(lambda v: v.accepted)

    @pytest.mark.parametrize('order', [(0, 1, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)])
    def test_parts_come_in_any_order(self, order):
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
        (whole,) = join.pop(0.1)
        assert whole.status.stamp_ns == 5
        assert whole.odometry is not None
        assert whole.cloud is not None
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

    def test_a_new_scan_keeps_the_parts_that_came_before_its_first_status(self):
        join = self.join()
        join.add_status(status(5), 0.0)
        join.add_odometry(odometry(6))
        join.add_cloud(cloud(6))
        join.restart()
        join.add_status(status(6), 0.1)
        (whole,) = join.pop(0.1)
        assert (whole.status.stamp_ns, whole.cloud is not None) == (6, True)

    def test_what_never_comes_is_given_up(self):
        join = self.join()
        join.add_status(status(5), 0.0)
        join.add_odometry(odometry(5))
        assert not list(join.pop(PATIENCE_S - 0.1))
        (part,) = join.pop(PATIENCE_S + 0.1)
        assert part.cloud is None
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


class TestIdentity:
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
        monkeypatch.setattr(scan_identity.time, 'monotonic', lambda: now + 10)
        assert identity.reset()
        assert identity.of(20) == STALE


def test_a_replays_stamps_are_brought_to_the_clock():
    clock = SensorClock()
    now = time.time_ns()
    assert clock.age_s(10**9, now) is None
    clock.learn({k: str(v) for k, v in replay_values(10**9, now, 2.0).items()})
    # half a second after the start, at twice the speed, a second of the recording has gone by
    assert clock.age_s(2 * 10**9, now + 530_000_000) == pytest.approx(0.03)
    clock.learn({'first_stamp_ns': 'soon'})
    assert clock.age_s(2 * 10**9, now + 530_000_000) == pytest.approx(0.03)


class TestWorker:
    def test_work_is_done_in_order_and_answers_come_back(self):
        done, between = [], []
        worker = Worker(lambda: between.append(len(done)))
        worker.start()
        for k in range(50):
            worker.post(lambda k=k: done.append(k))
        job = worker.ask(lambda: (True, 'all of it'))
        for _ in job.__await__():
            pass
        assert done == list(range(50))
        assert job.answer == (True, 'all of it')
        worker.stop()
        assert len(between) >= 50
        worker.check()

    def test_what_ends_it_is_raised_and_does_not_leave_a_caller_waiting(self):
        worker = Worker(lambda: None)
        worker.start()

        def fail():
            raise ValueError('broken')

        job = worker.ask(fail)
        for _ in job.__await__():
            pass
        assert job.answer == (False, 'failed: broken')
        worker.stop()
        with pytest.raises(ValueError, match='broken'):
            worker.check()

    def test_a_task_can_let_those_behind_it_go_first(self):
        done = []
        worker = Worker(lambda: None)

        def first():
            worker.work_until(lambda: len(done) == 2, 5.0)
            done.append('first')
            return True, ''

        job = worker.ask(first)
        worker.post(lambda: done.append('second'))
        worker.post(lambda: done.append('third'))
        worker.start()
        for _ in job.__await__():
            pass
        assert done == ['second', 'third', 'first']
        worker.stop()


class TestPacer:
    def test_sends_when_due_with_the_time_at_which_it_was(self):
        sent = []

        def series():
            for k in range(5):
                yield Due(k * 0.05, lambda due_ns: sent.append((due_ns, time.time_ns())), is_frame=k != 2)

        pacer = Pacer(series(), lambda stop: True)
        pacer.start()
        assert wait_for(lambda: pacer.finished, threading.Event(), 5.0)
        due = np.array([d for d, _ in sent])
        assert list(np.diff(due)) == [50_000_000] * 4
        assert all(at >= d for d, at in sent)
        assert pacer.sent == 4

    def test_stops_at_once_and_passes_errors_on(self):
        pacer = Pacer((Due(k * 60.0, lambda _: None, True) for k in range(9)), lambda stop: True)
        pacer.start()
        wait_for(lambda: pacer.sent == 1, threading.Event(), 5.0)
        pacer.stop()
        assert pacer.finished
        assert pacer.sent == 1

        def broken():
            raise ValueError('no frame')
            yield

        pacer = Pacer(broken(), lambda stop: True)
        pacer.start()
        pacer.stop()
        with pytest.raises(ValueError, match='no frame'):
            pacer.check()


@pytest.mark.parametrize('shift_ns', [1, 600_000_000, 7_200_000_000])
def test_a_played_again_message_differs_in_its_stamp_alone(shift_ns):
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import CameraInfo

    camera = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
    msg = camera_info_message(1_999_999_999, 'sensor', camera)
    moved = deserialize_message(restamped(serialize_message(msg), shift_ns), CameraInfo)
    assert read_stamp(moved.header.stamp) == 1_999_999_999 + shift_ns
    moved.header.stamp = msg.header.stamp
    assert moved == msg


def test_a_big_endian_message_is_moved_too():
    data = b'\0\0\0\0' + struct.pack('>iI', 5, 7) + b'rest'
    assert restamped(data, 10**9) == b'\0\0\0\0' + struct.pack('>iI', 6, 7) + b'rest'
