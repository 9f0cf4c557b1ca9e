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

"""A composed scanner that continues from its journal has the state of the killed one."""

import numpy as np

from debris_scanner.nodes.recovery.scanner_journal import ScannerJournal
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import SCANNING

FRAMES = 40


def journal_of(scanner, folder):
    return ScannerJournal(folder, scanner.front_end, scanner.back_end, Settings().normals)


def run(scanner, journal, frames, back_end_keeps_up=True):
    for frame in frames:
        step = scanner.front_end.process(frame)
        journal.frame(step.estimate)
        if back_end_keeps_up:
            scanner.back_end.add(step.estimate, step.target)
            scanner.back_end.add_closures(step.closures)


def test_the_next_process_goes_on_where_the_killed_one_stopped(recording, tmp_path):
    killed = Scanner()
    first = journal_of(killed, tmp_path)
    assert not first.resume()
    run(killed, first, recording.frames[:FRAMES])

    scanner = Scanner()
    second = journal_of(scanner, tmp_path)
    assert second.resume()
    assert not scanner.back_end.ended
    assert scanner.front_end.odometry.state == SCANNING
    assert scanner.back_end.recorder.used == FRAMES
    stamps = [k.stamp_ns for k in killed.back_end.builder.keyframes]
    for kept in (
        scanner.back_end.builder.keyframes,
        scanner.front_end.detector.keyframes.frames,
        scanner.front_end.odometry.keyframes.frames,
    ):
        assert [k.stamp_ns for k in kept] == stamps
    for a, b in zip(killed.back_end.recorder.odometry, scanner.back_end.recorder.odometry, strict=True):
        np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-9)
    for x, y in zip(killed.back_end.builder.store.frames, scanner.back_end.builder.store.frames, strict=True):
        np.testing.assert_array_equal(x.depth, y.depth)

    a, b = (s.process(recording.frames[FRAMES]).estimate for s in (killed, scanner))
    np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-5)


def test_key_frames_that_waited_for_the_builder_are_not_lost(recording, tmp_path):
    killed = Scanner()
    journal = journal_of(killed, tmp_path)
    assert not journal.resume()
    run(killed, journal, recording.frames[:20], back_end_keeps_up=False)
    scanner = Scanner()
    assert journal_of(scanner, tmp_path).resume()
    assert [k.stamp_ns for k in scanner.back_end.builder.keyframes] == [
        k.stamp_ns for k in killed.front_end.odometry.keyframes.frames
    ]


def test_a_new_scan_leaves_nothing_to_go_on_from(recording, tmp_path):
    scanner = Scanner()
    journal = journal_of(scanner, tmp_path)
    run(scanner, journal, recording.frames[:10])
    journal.restart()
    scanner.back_end.reset()
    assert not journal_of(Scanner(), tmp_path).resume()
