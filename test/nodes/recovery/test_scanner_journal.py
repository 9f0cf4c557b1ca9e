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

"""A composed scanner that goes on from its journal holds what the killed one held."""

import numpy as np

from debris_scanner.nodes.publishing.estimates import Verdict, estimate_messages
from debris_scanner.nodes.recovery.scanner_journal import ScannerJournal
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import SCANNING

FRAMES = 40


def journal_of(scanner, folder):
    return ScannerJournal(folder, scanner, scanner.builder, Settings().normals)


def run(scanner, journal, frames, worker_keeps_up=True):
    for frame in frames:
        step = scanner.process(frame)
        e, odometry = step.estimate, scanner.odometry
        path = odometry.keyframes.frames[-1].path_rad
        is_keyframe = e.keyframe is not None
        verdict = Verdict(
            e.stamp_ns, odometry.scan_ns, e.state, e.accepted, is_keyframe, False, path, e.usable_for_mapping
        )
        message, _ = estimate_messages(e, odometry.filter, 'sensor', verdict.frame_id)
        journal.frame(e)
        if worker_keeps_up:
            journal.taken(verdict, message, step.target, step.closures)


def test_the_next_process_goes_on_where_the_killed_one_stopped(recording, tmp_path):
    killed = Scanner()
    first = journal_of(killed, tmp_path)
    assert not first.resume()
    run(killed, first, recording.frames[:FRAMES])

    scanner = Scanner()
    second = journal_of(scanner, tmp_path)
    assert second.resume()
    assert not second.ended
    assert scanner.odometry.state == SCANNING
    assert scanner.frames_read == FRAMES
    stamps = [k.stamp_ns for k in killed.builder.keyframes]
    for kept in (
        scanner.builder.keyframes,
        scanner.detector.keyframes.frames,
        scanner.odometry.keyframes.frames,
    ):
        assert [k.stamp_ns for k in kept] == stamps
    for a, b in zip(killed.recorder.odometry, scanner.recorder.odometry, strict=True):
        np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-9)
    for x, y in zip(killed.builder.store.frames, scanner.builder.store.frames, strict=True):
        np.testing.assert_array_equal(x.depth, y.depth)

    a, b = (s.process(recording.frames[FRAMES]).estimate for s in (killed, scanner))
    np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-5)


def test_key_frames_that_waited_for_the_builder_are_not_lost(recording, tmp_path):
    killed = Scanner()
    run(killed, journal_of(killed, tmp_path), recording.frames[:20], worker_keeps_up=False)
    scanner = Scanner()
    assert journal_of(scanner, tmp_path).resume()
    assert [k.stamp_ns for k in scanner.builder.keyframes] == [k.stamp_ns for k in killed.builder.keyframes]


def test_a_new_scan_leaves_nothing_to_go_on_from(recording, tmp_path):
    scanner = Scanner()
    journal = journal_of(scanner, tmp_path)
    run(scanner, journal, recording.frames[:10])
    journal.restart()
    journal.restart_models()
    assert not journal_of(Scanner(), tmp_path).resume()
