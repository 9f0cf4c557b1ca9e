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

"""An exception costs one frame, one attempt at a model or one figure, and is counted; the scan goes on."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from debris_scanner.back_end import WAITING, ScanEvents
from debris_scanner.core.frames import DepthFrame, FrameRejected
from debris_scanner.core.optional import MissingLibrary
from debris_scanner.core.results import ERROR
from debris_scanner.faults import Faults, counted
from debris_scanner.mapping.closures import Closure, ClosureDetector
from debris_scanner.modelling.generation import Generation
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.tracking.local_map import LocalMap
from debris_scanner.tracking.odometry import DEGENERATE_FIT, NOT_REGISTERED

FRAMES = 30
ROOT = Path(__file__).resolve().parents[1]
RAISING = Path(__file__).resolve().parent / 'raising'


def test_the_first_exception_of_a_type_is_logged_with_its_traceback():
    said = []
    faults = Faults(said.append)
    for divisor in (0, 0, 1):
        with faults.contained('a frame'):
            1 / divisor
    assert faults.counts == {'ZeroDivisionError': 1 + 1}
    (text,) = said
    assert text.startswith('a frame is left out, the scan goes on: ZeroDivisionError: division by zero\n')
    assert 'Traceback' in text and '1 / divisor' in text


def test_the_next_process_goes_on_from_what_a_killed_one_counted(tmp_path):
    def process():
        faults = Faults(lambda _: None)
        faults.remember(tmp_path / 'journal', 'graph')
        return faults

    killed = process()
    for error in (ValueError('0'), ZeroDivisionError(), ValueError('1')):
        killed.note(error, 'a frame')
    restarted = process()
    restarted.note(ValueError('2'), 'a frame')
    restarted.remember(tmp_path / 'journal', 'graph')  # configured anew
    assert restarted.counts == process().counts == {'ValueError': 3, 'ZeroDivisionError': 1}
    assert not counted(tmp_path / 'journal', 'odometry')
    restarted.reset()
    assert not process().counts
    (tmp_path / 'journal').rmdir()
    restarted.note(ValueError('of a scan that has ended'), 'a frame')
    assert restarted.counts == {'ValueError': 1}


def test_a_rejected_frame_is_no_error():
    faults, rejected = Faults(pytest.fail), Counter()
    with faults.contained('a frame', rejected) as contained:
        raise FrameRejected('no_target', 'empty')
    assert (contained.reason, contained.message) == ('no_target', 'no_target: empty')
    assert rejected == {'no_target': 1} and not faults.counts


def test_a_missing_library_ends_the_scan():
    with pytest.raises(MissingLibrary), Faults(pytest.fail).contained('a frame'):
        raise MissingLibrary.named('numba')


def raise_at(monkeypatch, owner, name, call):
    """Let a method raise at its n-th call, from 1."""
    original, calls = getattr(owner, name), 0

    def raising(*args, **kwargs):
        nonlocal calls
        calls += 1
        if calls == call:
            raise ZeroDivisionError('injected')
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, raising)


@pytest.mark.parametrize(
    ('owner', 'name', 'lost'),
    [
        (Preprocessor, 'process', 1),
        (LocalMap, 'register', 1),
        (LocalMap, 'add', 1),
        (ClosureDetector, 'remember', 0),  # a key frame without closures is a key frame
        (ModelBuilder, 'add_frame', 1),
    ],
)
def test_one_frame_that_raises_is_lost_and_no_more(coarse_recording, monkeypatch, owner, name, lost):
    raise_at(monkeypatch, owner, name, 5)
    scanner = Scanner()
    for frame in coarse_recording.frames[:FRAMES]:
        scanner.process(frame)
    result = scanner.finish()
    assert result.errors == {'ZeroDivisionError': 1}
    assert result.frames_read == FRAMES
    assert result.frames_rejected == ({ERROR: 1} if lost else {})
    assert result.reason == 'no_closure'
    assert len(result.odometry) == FRAMES - lost
    assert scanner.state == 'scanning' and scanner.front_end.odometry.submap == 0


def test_a_closure_with_a_key_frame_that_was_lost_is_left_out(coarse_recording):
    scanner = Scanner()
    for frame in coarse_recording.frames[:FRAMES]:
        scanner.process(frame)
    back_end = scanner.back_end
    a, b = (k.stamp_ns for k in back_end.builder.keyframes[:2])
    closures = [Closure(f, t, 0.9, True, '', np.eye(4)) for f, t in ((a, b + 1), (a + 1, b), (a, b))]
    back_end.add_closures(closures)
    assert back_end.builder.graph.closures == closures[2:]
    assert len(back_end.recorder.closures) == 3


def test_an_attempt_that_raises_puts_everything_back(coarse_recording, monkeypatch):
    scanner = Scanner()
    for frame in coarse_recording.frames[:FRAMES]:
        scanner.process(frame)
    builder = scanner.back_end.builder
    poses = [k.T_target_sensor for k in builder.keyframes]

    def raising(*_):
        for keyframe in builder.keyframes:
            keyframe.T_target_sensor = keyframe.T_target_sensor + np.nan
        builder.graph.closures = []
        builder.store.frames = []
        raise np.linalg.LinAlgError('SVD did not converge')

    monkeypatch.setattr(builder._attempts, '_attempt', raising)
    result = scanner.finish()
    assert (result.reason, result.errors) == (ERROR, {'LinAlgError': 1})
    assert 'SVD did not converge' in builder.last.why
    assert all(a is b for a, b in zip(poses, (k.T_target_sensor for k in builder.keyframes), strict=True))
    assert len(result.poses) == FRAMES


def test_a_model_that_cannot_be_shown_is_a_model(true_model, monkeypatch):
    class Events(ScanEvents):
        def model_built(self, generation, final):
            raise ZeroDivisionError('injected')

    back_end = Scanner(events=Events()).back_end
    made = Generation(true_model, None, '', {}, None)
    monkeypatch.setattr(back_end.builder, 'attempt', lambda *_: made)
    assert back_end.generate() is made
    assert back_end.state.value == WAITING
    assert back_end.faults.counts == {'ZeroDivisionError': 1}


def test_where_the_last_attempt_raises_the_model_so_far_stands(coarse_recording, monkeypatch):
    scanner = Scanner()
    for frame in coarse_recording.frames[::2]:
        scanner.process(frame)
    assert scanner.back_end.builder.has_model
    monkeypatch.setattr('debris_scanner.modelling.build_model.close', lambda *_: 1 / 0)
    result = scanner.finish()
    assert result.reason is None and result.model is not None
    assert result.errors == {'ZeroDivisionError': 1}


def test_a_scan_begins_with_the_first_frame_that_shows_surface(recording):
    """A line one pixel wide has no plane: it used to begin a scan, and NaN entered the filter."""
    frames = recording.frames[:4]
    line = np.zeros_like(frames[0].depth)
    line[200:280, 320] = 0.8
    scanner = Scanner()
    scanner.process(DepthFrame(frames[0].stamp_ns - 10**8, line, frames[0].camera))
    steps = [scanner.process(frame) for frame in frames]
    assert all(step.estimate is not None and step.estimate.accepted for step in steps)
    assert set(scanner.front_end.rejected) <= {NOT_REGISTERED, 'settling', 'no_target'}


def test_a_recording_that_ends_while_it_settles_gives_its_frames(recording, monkeypatch):
    def settling(*_):
        raise FrameRejected('settling', '2 things in the box')

    monkeypatch.setattr(Preprocessor, 'process', settling)
    scanner = Scanner()
    empty = DepthFrame(1, np.zeros((480, 640), np.float32), recording.frames[0].camera)
    for frame in [empty, *recording.frames[:6]]:
        assert scanner.process(frame).rejected == 'settling'
    result = scanner.finish()
    assert len(result.odometry) == 6
    assert result.frames_rejected == {'no_target': 1}  # each has a reason of its own


def test_equations_without_a_finite_solution_reject_the_frame(recording, monkeypatch):
    scanner = Scanner()
    for frame in recording.frames[:5]:
        scanner.process(frame)

    def nowhere(motion, *_):
        motion.centre = motion.centre + np.nan
        return np.full(21, np.nan)

    monkeypatch.setattr('debris_scanner.tracking.motion_filter.MotionFilter.update_step', nowhere)
    step = scanner.process(recording.frames[5])
    assert not step.estimate.accepted and step.estimate.rejected == DEGENERATE_FIT
    assert np.isfinite(step.estimate.T_sensor_target).all()
    monkeypatch.undo()
    assert scanner.process(recording.frames[6]).estimate.accepted
    assert scanner.finish().frames_rejected == {DEGENERATE_FIT: 1}


def test_frames_that_raise_one_after_the_other_begin_a_submap(recording, monkeypatch):
    scanner = Scanner()
    for frame in recording.frames[:5]:
        scanner.process(frame)
    monkeypatch.setattr(LocalMap, 'register', lambda *_: 1 / 0)
    for frame in recording.frames[5:8]:
        assert scanner.process(frame).rejected == ERROR
    monkeypatch.undo()
    assert scanner.process(recording.frames[8]).estimate.submap == 1


@pytest.mark.slow
def test_the_command_line_says_it_once_and_goes_on(brief_bag, tmp_path):
    words = [
        'debris_scanner.tracking.odometry:Odometry.process:20',
        'debris_scanner.sensing.preprocessing:Preprocessor.process:30',
        'debris_scanner.modelling.model_builder:ModelBuilder.generate:1',
    ]
    variables = {'PYTHONPATH': f'{RAISING}:{ROOT}', 'RAISE_AT': ' '.join(words), 'RAISED': str(tmp_path)}
    out = tmp_path / 'out'
    done = subprocess.run(
        [sys.executable, '-m', 'debris_scanner', 'scan', brief_bag, '--out', out],
        capture_output=True,
        text=True,
        env=os.environ | variables,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count('Traceback') == 1
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['result'] == 'model'
    assert summary['errors'] == {'ZeroDivisionError': 3}
    assert summary['frames']['rejected'] == {'error': 2}
