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

"""A graph stage that is replayed from its journal holds what the killed one held."""

import os

import numpy as np
import pytest

from debris_scanner.core.results import ClosureRecord
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.publishing.estimates import Verdict, estimate_messages
from debris_scanner.nodes.recovery.graph_journal import FILE, GraphJournal
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.graph_stage import GraphStage
from debris_scanner.nodes.scan.joining import JoinedFrame
from debris_scanner.scanner import Scanner, make_model_builder
from debris_scanner.settings import Settings
from msg_adapters.target_frames import target_frame_message

FRAMES = 40


@pytest.fixture(scope='module')
def joined(recording):
    """Frames as the graph node gets them."""
    scanner, frames = Scanner(), []
    for frame in recording.frames[:FRAMES]:
        step = scanner.process(frame)
        e = step.estimate
        first_ns = scanner.odometry.keyframes.frames[0].stamp_ns
        path = scanner.odometry.keyframes.frames[-1].path_rad
        verdict = Verdict(e.stamp_ns, first_ns, e.state, e.accepted, e.keyframe is not None, False, path)
        odometry, _ = estimate_messages(e, scanner.odometry.filter, 'sensor', verdict.frame_id)
        frames.append(JoinedFrame(verdict, odometry, target_frame_message(step.target, 'sensor')))
    return frames


def stage(folder):
    made = GraphStage(make_model_builder(Settings()), StageTimer(), FrameStatistics(), pytest.fail)
    journal = GraphJournal(folder, Settings().normals)
    journal.replay(made)
    made.journal = journal
    return made


def same(a, b):
    assert [k.stamp_ns for k in a.builder.keyframes] == [k.stamp_ns for k in b.builder.keyframes]
    for x, y in zip(a.builder.keyframes, b.builder.keyframes, strict=True):
        np.testing.assert_array_equal(x.T_target_sensor, y.T_target_sensor)
        assert x.path_rad == y.path_rad
    posed = [stage.builder.graph.keyframes.posed for stage in (a, b)]
    for (x, _), (y, _) in zip(*posed, strict=True):
        np.testing.assert_array_equal(x.depth, y.depth)
        np.testing.assert_allclose(x.normals, y.normals, atol=1e-5)
    for x, y in zip(a.builder.store.frames, b.builder.store.frames, strict=True):
        assert (x.stamp_ns, x.keyframe_ns, x.camera) == (y.stamp_ns, y.keyframe_ns, y.camera)
        np.testing.assert_allclose(x.T, y.T, atol=1e-12)
        np.testing.assert_array_equal(x.depth, y.depth)
    for x, y in zip(a.recorder.rates, b.recorder.rates, strict=True):
        np.testing.assert_array_equal(x.omega, y.omega)
    assert a.recorder.closures == b.recorder.closures
    assert a.statistics.used == b.statistics.used == FRAMES


def closure(stage, i, j, accepted=True):
    a, b = (stage.builder.keyframes[k].stamp_ns for k in (i, j))
    return Closure(a, b, 0.9, accepted, 'why', np.eye(4))


def test_everything_comes_back(tmp_path, joined):
    first = stage(tmp_path)
    for frame in joined:
        first.take(frame)
    record = ClosureRecord(1, 2, 0.5, False, 'no')
    first.note_candidates([record])
    first.journal.candidates([record])
    for i, j in ((0, 3), (1, 5)):
        first.builder.add_closure(closure(first, i, j))
        first.journal.closure(closure(first, i, j))
    second = stage(tmp_path)
    same(first, second)
    pairs = [(c.from_stamp_ns, c.to_stamp_ns) for c in first.builder.graph.closures]
    assert [(c.from_stamp_ns, c.to_stamp_ns) for c in second.builder.graph.closures] == pairs
    assert second.builder.should_rebuild
    assert second.journal.last == joined[-1].verdict
    assert not second.journal.ended


def test_a_model_puts_the_key_frames_where_it_left_them(tmp_path, joined):
    first = stage(tmp_path)
    for frame in joined[:30]:
        first.take(frame)
    for pair in ((0, 3), (1, 4)):
        first.journal.closure(closure(first, *pair))
    first.builder.add_closure(closure(first, 0, 3))  # the other one was dropped
    first.builder.T_model_scan = np.eye(4)
    first.builder.T_model_scan[0, 3] = 0.05
    for keyframe in first.builder.keyframes:
        keyframe.T_target_sensor = keyframe.T_target_sensor @ np.diag([1.0, 1, 1, 1])
        keyframe.T_target_sensor[0, 3] += 0.05
    first.journal.generated(first.builder)
    for frame in joined[30:]:
        first.take(frame)
    first.journal.end()
    second = stage(tmp_path)
    same(first, second)
    np.testing.assert_array_equal(second.builder.T_model_scan, first.builder.T_model_scan)
    assert len(second.builder.graph.closures) == 1
    assert second.journal.ended


def test_a_new_scan_begins_an_empty_journal_and_a_torn_one_ends_early(tmp_path, joined):
    first = stage(tmp_path)
    for frame in joined:
        first.take(frame)
    size = (tmp_path / FILE).stat().st_size
    assert size < FRAMES * 30_000
    os.truncate(tmp_path / FILE, size - 5)
    assert stage(tmp_path).statistics.used == FRAMES - 1
    first.reset()
    assert stage(tmp_path).journal.last is None
