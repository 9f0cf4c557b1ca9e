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

"""The state machine of a scan: generate, publish, save, finish; whoever drives it."""

import fcntl
import json
import os
import shutil

import numpy as np
import pytest
from coarse_frames import coarse

from debris_scanner.back_end import (
    ATTEMPTS_SHARE,
    AttemptBudget,
    BackEnd,
    ScanEvents,
    ScanOutput,
    ScanState,
)
from debris_scanner.core.results import INTERRUPTED, NO_CLOSURE
from debris_scanner.core.timing import StageTimer
from debris_scanner.io.result_files import OutputError, ScanResult
from debris_scanner.io.scan_journal import ScanJournal
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.optimiser import Optimised
from debris_scanner.mapping.relaxation import Edge, Relaxed
from debris_scanner.modelling.generation import Generation
from debris_scanner.recorder import FrameCounts
from debris_scanner.scanner import FrontEnd
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector, make_model_builder

TURN = 132  # frames: a turn and a bit


class Seen(ScanEvents):
    """Takes a note of everything that is shown."""

    def __init__(self):
        self.states, self.models, self.texts, self.began, self.keyframes = [], [], [], 0, 0

    def state_changed(self, state):
        self.states.append(state)

    def keyframe_added(self, keyframes):
        self.keyframes = len(keyframes)

    def model_built(self, generation, final):
        self.models.append((generation, final))

    def scan_began(self):
        self.began += 1

    def log(self, text, warning=False):
        self.texts.append((text, warning))


@pytest.fixture(scope='module')
def steps(recorded_frames):
    front_end = FrontEnd(Settings(), StageTimer())
    return [front_end.process(coarse(frame)) for frame in recorded_frames[:TURN]]


def make(folder=None, rejected=None):
    events = Seen()
    counts = FrameCounts(rejected or {}, {'stage': {'count': 1}})
    output = ScanOutput(folder)
    return BackEnd(make_model_builder(Settings()), lambda: counts, events, output), events


def feed(back_end, steps):
    for step in steps:
        back_end.state.odometry(step.estimate.state, step.estimate.tracked, step.estimate.submap)
        back_end.add(step.estimate, step.target, step.closures)
        if back_end.advance() is not None:
            return


@pytest.fixture(scope='module')
def closed(steps, tmp_path_factory):
    """A scan up to its first model, saved and journalled."""
    folder = tmp_path_factory.mktemp('out')
    back_end, events = make(folder, {'no_target': 2})
    back_end.resume(ScanJournal(tmp_path_factory.mktemp('journal'), Settings().normals))
    feed(back_end, steps)
    return back_end, events, folder


def test_a_closed_loop_builds_publishes_and_saves_a_model(closed):
    back_end, events, folder = closed
    ((generation, final),) = events.models
    assert generation.model is not None and not final
    assert back_end.builder.has_model and not back_end.ended
    # generating from the first attempt on, until odometry says that it tracks
    assert events.states[:3] == ['waiting', 'scanning', 'generating']
    assert events.keyframes == len(back_end.builder.keyframes)
    assert (folder / 'model.ply').is_file()
    assert any('a model of' in text and not warning for text, warning in events.texts)
    assert back_end.timer.summary()['closure_to_model']['count'] == 1
    back_end.state.odometry('tracking', tracked=True, submap=0)
    assert events.states[-1] == 'tracking'


def test_what_was_dropped_before_it_is_counted(closed, steps):
    back_end, _, folder = closed
    frames = json.loads((folder / 'summary.json').read_text())['frames']
    used = back_end.recorder.used
    assert frames == {'read': used + 2, 'used': used, 'rejected': {'no_target': 2}}


def test_without_a_detector_key_frames_are_described_at_the_end(steps):
    """As one would have: `live` has its detector in another process."""
    back_end, _ = make()
    detector = make_closure_detector(Settings())
    assert back_end.end().descriptions is None
    back_end.reset()
    back_end.descriptor = Settings().descriptor
    for step in steps[:30]:
        back_end.add(step.estimate, step.target)
        if step.estimate.keyframe is not None:
            detector.remember(step.estimate.keyframe)
    expected, found = detector.descriptions, back_end.end().descriptions
    assert len(found.stamps_ns) > 5
    np.testing.assert_array_equal(found.stamps_ns, expected.stamps_ns)
    np.testing.assert_allclose(found.histograms, expected.histograms, atol=1e-5)
    np.testing.assert_allclose(found.attitudes, expected.attitudes)
    back_end.reset()
    assert back_end.save_interrupted()[0] is False  # at once, without


def test_a_journal_brings_the_model_back(closed):
    back_end = closed[0]
    again, _ = make()
    assert again.resume(ScanJournal(back_end.journal.path.parent, Settings().normals))
    assert again.resumed_model
    np.testing.assert_array_equal(again.builder.T_model_scan, back_end.builder.T_model_scan)
    assert again.generate().model is not None
    assert not again.resumed_model
    assert again.output.owned, 'the model in the folder is of this scan'


def test_live_attempts_take_a_fifth_of_the_time(monkeypatch):
    back_end, _ = make()
    now, attempts = [100.0], []
    monkeypatch.setattr('debris_scanner.back_end.time.monotonic', lambda: now[0])
    monkeypatch.setattr(type(back_end.builder), 'should_rebuild', True)

    def attempt():
        attempts.append(now[0])
        now[0] += 3.0
        return Generation(object(), None, '', {}, None)

    monkeypatch.setattr(back_end, 'generate', attempt)
    while now[0] < 160.0:
        back_end.advance(live=True)
        now[0] += 0.2
    assert len(attempts) == 4
    assert np.diff(attempts) == pytest.approx(15.0, abs=0.3)
    assert back_end.advance() is not None, 'offline nothing waits'


class Rejecting:
    """An optimisation that has switched off the closures of these key frames."""

    def __init__(self, *stamps):
        self.rejected_closures = set(stamps)


def refused(reason='inconsistent', at_fault=()):
    return Generation(None, reason, '', {}, Rejecting(*at_fault))


@pytest.mark.parametrize('reason', [None, 'inconsistent'])
@pytest.mark.parametrize('growing', [1.0, 1.4])
def test_over_any_minute_attempts_take_a_fifth_of_the_time(reason, growing):
    budget, now_s, took_s, spent = AttemptBudget(), 0.0, 1.0, []
    while now_s < 600.0:
        keyframes = 10 ** len(spent)  # always enough new ones
        if budget.allows(now_s, keyframes, live=True):
            spent.append((now_s, now_s + took_s))
            budget.note(*spent[-1], Generation(None, reason, '', {}, None), keyframes)
            now_s, took_s = now_s + took_s, min(took_s * growing, 10.0)
        now_s += 0.1
    assert len(spent) >= 8
    for since_s in np.arange(0.0, 540.0, 0.5):
        within = sum(max(0.0, min(b, since_s + 60.0) - max(a, since_s)) for a, b in spent)
        longest = max(b - a for a, b in spent)
        assert within <= ATTEMPTS_SHARE * 60.0 + (growing - 1.0) * longest, since_s


def test_attempts_refused_for_the_same_reason_become_rare():
    budget, refusals = AttemptBudget(), []
    for keyframes in range(20, 600):
        now_s = 100.0 * keyframes  # the time is never what is missing
        if budget.allows(now_s, keyframes, live=True):
            refusals.append(keyframes)
            budget.note(now_s, now_s + 1.0, refused(), keyframes)
    assert len(refusals) <= 6
    grown = np.array(refusals[1:]) / refusals[:-1]
    assert grown == pytest.approx(1 + 0.1 * 2.0 ** np.arange(len(grown)), rel=0.06)
    budget.note(1e6, 1e6 + 1.0, refused('another'), 600)
    assert budget.allows(2e6, 661, live=True) and not budget.allows(2e6, 659, live=True), (
        'another reason starts anew'
    )


@pytest.mark.parametrize('reason', [None, 'inconsistent'])
def test_offline_each_attempt_has_twice_the_key_frames_of_the_one_before(reason):
    budget, attempts = AttemptBudget(), []
    for keyframes in range(30, 600):
        budget.closure_added(Closure(20, 50, 0.9, True, 'test', np.eye(4)))
        if budget.allows(0.0, keyframes, live=False):
            attempts.append(keyframes)
            generation = Generation(None, reason, '', {}, Rejecting(50) if reason else None)
            budget.note(0.0, 1.0, generation, keyframes)
    assert attempts == [30, 60, 120, 240, 480]
    assert sum(attempts) < 2 * attempts[-1]


def test_a_closure_of_a_key_frame_at_fault_calls_for_another_attempt():
    budget = AttemptBudget()
    budget.note(0.0, 1.0, refused(at_fault=(40, 50)), 30)
    assert not budget.allows(100.0, 31, live=True)
    budget.closure_added(Closure(10, 20, 0.9, True, 'test', np.eye(4)))
    assert not budget.allows(100.0, 31, live=True)
    budget.closure_added(Closure(20, 50, 0.9, True, 'test', np.eye(4)))
    assert budget.allows(100.0, 31, live=True)
    assert not budget.allows(2.0, 31, live=True), 'but not at once'


def test_key_frames_of_rejected_closures_are_told():
    edges = [Edge(1, 0, False), Edge(2, 0, True), Edge(3, 1, True)]
    relaxed = Relaxed([], [], [0.1, 0.2, 0.9], [])
    assert Optimised({}, [10, 20, 30, 40], edges, relaxed).rejected_closures == {10, 30}


def test_finishing_takes_the_last_model_and_no_more_frames(steps, tmp_path):
    back_end, events = make(tmp_path)
    feed(back_end, steps[:25])
    done, text = back_end.finish()
    assert done
    assert text == f'no model: {NO_CLOSURE}, saved: {tmp_path / "summary.json"}'
    assert back_end.ended
    assert back_end.advance() is None
    generations = [t for t, warning in events.texts if warning]
    assert len(generations) == 1, 'the last optimisation is made but once'


def test_an_interrupted_scan_is_saved_at_once(steps, tmp_path):
    back_end, _ = make(tmp_path)
    feed(back_end, steps[:12])
    back_end.save_interrupted()
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert (summary['result'], summary['reason']) == ('no_model', INTERRUPTED)
    assert not back_end.ended
    assert back_end.finish(INTERRUPTED)[0]
    assert json.loads((tmp_path / 'summary.json').read_text())['reason'] == INTERRUPTED


def test_a_scan_without_a_model_leaves_that_of_another_scan(closed, steps, tmp_path):
    folder = tmp_path / 'out'
    shutil.copytree(closed[2], folder)
    (folder / 'metrics.json').write_text('{}')
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    back_end, events = make(folder)
    feed(back_end, steps[:12])
    saves = (back_end.save_interrupted, back_end.save, lambda: back_end.finish(INTERRUPTED))
    for save in (*saves, lambda: back_end.reset() or back_end.finish()):
        done, text = save()
        assert done == (save != back_end.save)  # that is asked for a model
        assert str(folder / 'no_model' / 'summary.json') in text
        assert (f'{folder} holds the model of another scan and is left as it is', True) in events.texts
        events.texts.clear()
    assert json.loads((folder / 'no_model' / 'summary.json').read_text())['result'] == 'no_model'
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_a_model_replaces_that_of_another_scan_and_is_its_own_scan_s_to_replace(closed, steps, tmp_path):
    folder = tmp_path / 'out'
    shutil.copytree(closed[2], folder)
    (folder / 'model.ply').write_bytes(b'of another scan')
    back_end, _ = make(folder)
    feed(back_end, steps)
    assert (folder / 'model.ply').read_bytes() == (closed[2] / 'model.ply').read_bytes()
    back_end.output.save(ScanResult(NO_CLOSURE, None))  # as when the last checks refuse it
    assert not (folder / 'model.ply').exists() and not (folder / 'no_model').exists()


@pytest.mark.parametrize('content', ['', '[]', '{"model": null}', '{'])
def test_what_is_no_result_with_a_model_protects_nothing(steps, tmp_path, content):
    (tmp_path / 'summary.json').write_text(content)
    assert ScanOutput(tmp_path).save(ScanResult(NO_CLOSURE, None))[0]
    assert json.loads((tmp_path / 'summary.json').read_text())['reason'] == NO_CLOSURE


def test_saving_succeeds_only_with_a_model(steps, tmp_path):
    back_end, _ = make(tmp_path)
    feed(back_end, steps[:12])
    done, text = back_end.save()
    assert not done
    assert text.startswith('no model: ') and 'saved: ' in text
    assert (tmp_path / 'summary.json').is_file()


def test_without_a_folder_nothing_is_saved_and_it_says_so(steps):
    back_end, _ = make()
    feed(back_end, steps[:12])
    done, text = back_end.save()
    assert not done and 'output_dir is empty' in text


def test_a_folder_that_cannot_be_written_is_said_at_once_or_later(steps, tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(OutputError):
        ScanOutput(tmp_path / 'file')
    folder = tmp_path / 'out'
    back_end, _ = make(folder)
    feed(back_end, steps[:12])
    folder.rmdir()
    folder.write_text('in the way')
    done, text = back_end.save()
    assert not done
    assert back_end.output.problem in text


def test_a_folder_is_one_scans_until_it_is_closed(tmp_path):
    output = ScanOutput(tmp_path)
    other = os.open(tmp_path, os.O_RDONLY)
    try:
        with pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        output.close()
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with pytest.raises(OutputError, match='another scan'):
            ScanOutput(tmp_path)
    finally:
        os.close(other)


def test_the_phase_of_the_end_is_told_while_it_lasts(steps, monkeypatch):
    back_end, _ = make()
    feed(back_end, steps[:12])
    attempt, phases = back_end.builder.attempt, [back_end.state.phase]

    def telling(faults, final, progress):
        for done in (3, 10):
            phases.append(back_end.state.phase)
            progress('refining', done, 10)
        phases.append(back_end.state.phase)
        return attempt(faults, final)

    monkeypatch.setattr(back_end.builder, 'attempt', telling)
    back_end.finish()
    assert phases == ['', 'relaxing the graph', 'refining 3 of 10', 'making the model']
    assert back_end.state.phase == ''


def test_reset_forgets_the_scan(steps):
    back_end, events = make()
    feed(back_end, steps[:12])
    back_end.end()
    back_end.reset()
    assert events.began == 1
    assert (back_end.recorder.used, back_end.ended, back_end.builder.keyframes) == (0, False, [])
    feed(back_end, steps[:5])
    assert back_end.recorder.used == 5


def test_of_a_frame_that_is_not_kept_the_pose_counts(steps, tmp_path):
    back_end, _ = make()
    back_end.resume(ScanJournal(tmp_path, Settings().normals))
    feed(back_end, steps[:8])
    stored = len(back_end.builder.store.frames)
    step = next(s for s in steps[8:] if s.estimate.keyframe is None)
    back_end.add(step.estimate, None)
    assert (back_end.recorder.used, len(back_end.builder.store.frames)) == (9, stored)
    assert back_end.recorder.rates[-1].stamp_ns == step.estimate.stamp_ns
    again, _ = make()
    again.resume(ScanJournal(tmp_path, Settings().normals))
    assert (again.recorder.used, len(again.builder.store.frames)) == (9, stored)


@pytest.mark.parametrize('announced', [True, False])
def test_generating_lasts_until_the_model_is_tracked(announced):
    states = []
    state = ScanState(states.append)
    state.generation_began()
    state.generation_ended(0 if announced else None)
    state.odometry('scanning', tracked=False, submap=0)
    state.odometry('tracking', tracked=True, submap=0)
    state.odometry('scanning', tracked=True, submap=0)
    before = ['waiting', 'generating']
    assert states == [*before, *([] if announced else ['waiting', 'scanning']), 'tracking', 'scanning']
    state.odometry('lost', tracked=True, submap=0)
    state.generation_began()
    assert state.value == 'lost'


def test_a_model_of_an_earlier_submap_is_not_waited_for():
    states = []
    state = ScanState(states.append)
    state.generation_began()
    state.odometry('scanning', tracked=False, submap=1)  # odometry has begun another one meanwhile
    state.generation_ended(0)
    state.odometry('scanning', tracked=False, submap=1)
    assert states == ['waiting', 'generating', 'scanning']


def test_a_silent_input_waits_and_an_ended_scan_is_finished():
    states = []
    state = ScanState(states.append)
    state.odometry('scanning', tracked=False, submap=0)
    state.generation_began()
    state.silent(True)
    state.generation_ended(0)  # nobody will track the model: no frame comes
    state.silent(False)
    state.odometry('tracking', tracked=True, submap=0)
    state.finished()
    state.odometry('lost', tracked=True, submap=0)
    state.silent(True)
    state.reset()
    assert states == [
        'waiting', 'scanning', 'generating', 'waiting', 'generating', 'tracking', 'finished', 'waiting'
    ]  # fmt: skip


def test_a_scan_is_saved_under_a_name_beside_the_rest(steps, tmp_path):
    back_end, _ = make(tmp_path)
    feed(back_end, steps[:12])
    back_end.end()
    done, text = back_end.save('first')
    assert not done and 'no model' in text  # but what there is is saved
    assert (tmp_path / 'first' / 'summary.json').is_file()
    assert not (tmp_path / 'summary.json').exists()
