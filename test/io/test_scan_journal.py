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

"""A back end that is replayed from its journal holds what the killed one held."""

import os

import numpy as np
import pytest

from debris_scanner.back_end import BackEnd
from debris_scanner.core.geometry import exp_se3
from debris_scanner.core.results import ClosureRecord
from debris_scanner.core.timing import StageTimer
from debris_scanner.io.scan_journal import FILE, ScanJournal, make_way
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.placement import Answer
from debris_scanner.recorder import FrameCounts
from debris_scanner.scanner import FrontEnd
from debris_scanner.settings import Settings
from debris_scanner.stages import make_model_builder

FRAMES = 40


@pytest.fixture(scope='module')
def steps(recording):
    """What the front end makes of some frames."""
    front_end = FrontEnd(Settings(), StageTimer())
    return [front_end.process(frame) for frame in recording.frames[:FRAMES]]


def back_end(folder):
    made = BackEnd(make_model_builder(Settings()), lambda: FrameCounts({}, {}))
    made.resume(ScanJournal(folder, Settings().normals))
    return made


def add(back_end, steps):
    for step in steps:
        back_end.add(step.estimate, step.target)


def same(a, b):
    assert [k.stamp_ns for k in a.builder.keyframes] == [k.stamp_ns for k in b.builder.keyframes]
    for x, y in zip(a.builder.keyframes, b.builder.keyframes, strict=True):
        np.testing.assert_allclose(x.T_target_sensor, y.T_target_sensor, atol=1e-12)
        assert (x.path_rad, x.submap) == (y.path_rad, y.submap)
    posed = [one.builder.graph.keyframes.posed for one in (a, b)]
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
    assert a.recorder.used == b.recorder.used == FRAMES


def closure(one, i, j, accepted=True):
    a, b = (one.builder.keyframes[k].stamp_ns for k in (i, j))
    return Closure(a, b, 0.9, accepted, 'why', np.eye(4))


def test_everything_comes_back(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps)
    T = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, 0.5, 0.6]))
    first.add_hypotheses([ClosureRecord(1, 2, 0.5, False, 'no'), ClosureRecord(1, 3, 0.5, False, 'far', T)])
    for i, j in ((0, 3), (1, 5)):
        first.add_closure(closure(first, i, j))
    second = back_end(tmp_path)
    same(first, second)
    pairs = [(c.from_stamp_ns, c.to_stamp_ns) for c in first.builder.graph.closures]
    assert [(c.from_stamp_ns, c.to_stamp_ns) for c in second.builder.graph.closures] == pairs
    unmet, far = second.recorder.closures
    assert unmet.T_from_to is None
    np.testing.assert_allclose(far.T_from_to, T, atol=1e-15)
    assert second.builder.should_rebuild
    assert second.journal.last_stamp_ns == steps[-1].estimate.stamp_ns
    assert second.journal.last_scan_ns == steps[0].estimate.stamp_ns
    assert not second.ended


def test_a_model_puts_the_key_frames_where_it_left_them(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps[:30])
    first.journal.closure(closure(first, 1, 4))  # it was dropped
    first.add_closure(closure(first, 0, 3))
    first.builder.T_model_scan = np.eye(4)
    first.builder.answer = Answer('', '', disagreed=0.07)
    first.builder.T_model_scan[0, 3] = 0.05
    for keyframe in first.builder.keyframes:
        keyframe.T_target_sensor = keyframe.T_target_sensor @ np.diag([1.0, 1, 1, 1])
        keyframe.T_target_sensor[0, 3] += 0.05
    slipped = first.builder.keyframes[3].stamp_ns
    first.builder.note_slips({slipped})
    first.journal.generated(first.builder)
    add(first, steps[30:])
    first.journal.end()
    second = back_end(tmp_path)
    same(first, second)
    np.testing.assert_array_equal(second.builder.T_model_scan, first.builder.T_model_scan)
    assert second.builder.answer.disagreed == 0.07
    assert len(second.builder.graph.closures) == 1
    assert len(second.builder.store.frames) < FRAMES
    assert [k.stamp_ns for k in second.builder.keyframes if k.slipped] == [slipped]
    assert second.ended
    assert not second.resumed_model


def test_a_known_model_that_was_given_up_stays_so(tmp_path, steps, true_model):
    def of_a_known_model():
        made = BackEnd(make_model_builder(Settings(), model=true_model), lambda: FrameCounts({}, {}))
        made.resume(ScanJournal(tmp_path, Settings().normals))
        return made

    first = of_a_known_model()
    add(first, steps[:30])
    last = first.builder.keyframes[-1].stamp_ns
    first.builder.withdraw(last)
    first.journal.generated(first.builder)
    add(first, steps[30:])
    second = of_a_known_model()
    for one in (first, second):
        assert (one.builder.withdrawn_ns, one.builder.T_model_scan) == (last, None)
        assert {f.stamp_ns for f in one.builder.store.frames} == {s.target.stamp_ns for s in steps[30:]}


def test_a_new_scan_begins_an_empty_journal_and_a_torn_one_ends_early(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps)
    size = (tmp_path / FILE).stat().st_size
    assert size < FRAMES * 30_000
    os.truncate(tmp_path / FILE, size - 5)
    assert back_end(tmp_path).recorder.used == FRAMES - 1
    first.reset()
    assert back_end(tmp_path).journal.last_stamp_ns is None


def test_hypotheses_of_a_release_that_kept_no_pose_are_read(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps)
    old = {'from_stamp_ns': 1, 'to_stamp_ns': 2, 'probability': 0.5, 'accepted': False, 'why': 'no'}
    first.journal._journal.append('candidates', {'records': [old]})
    second = back_end(tmp_path)
    assert second.recorder.used == FRAMES
    assert second.recorder.closures == [ClosureRecord(1, 2, 0.5, False, 'no')]
    assert second.recorder.closures[0].T_from_to is None


def test_a_journal_of_another_release_begins_a_new_scan(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps[:5])
    first.journal._journal.append('frame', {'verdict': {'stamp_ns': 1}})
    second = back_end(tmp_path)
    assert (second.recorder.used, second.journal.last_stamp_ns) == (0, None)
    assert second.builder.keyframes == []


def test_a_scan_that_a_killed_process_had_saved_is_finished(tmp_path, steps):
    first = back_end(tmp_path)
    add(first, steps[:5])
    first.journal.end()
    second = back_end(tmp_path)
    assert second.ended
    assert second.finish() == (True, 'the scan was finished and saved before this process was started')


def test_only_a_scan_that_was_never_saved_is_put_aside(tmp_path, steps):
    journals = tmp_path / 'journal'
    assert make_way(journals) is None
    for number in (1, 2):
        journals.mkdir()
        add(back_end(journals), steps[:5])
        assert make_way(journals) == tmp_path / f'journal_{number}'
        assert not journals.exists()
    assert back_end(tmp_path / 'journal_1').recorder.used == 5
    journals.mkdir()
    saved = back_end(journals)
    add(saved, steps[:5])
    saved.journal.end()
    assert make_way(journals) is None
    assert [p.name for p in sorted(tmp_path.iterdir())] == ['journal_1', 'journal_2']
