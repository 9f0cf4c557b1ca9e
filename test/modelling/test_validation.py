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

"""The verdict: its reasons, its words, and the few key frames that it leaves out."""

import numpy as np
import pytest
from posed_frames import simulated

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
    in_words,
)
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling import validation
from debris_scanner.modelling.validation import (
    PosedKeyFrames,
    VerdictSettings,
    _parts,
    judge_poses,
    judge_scan,
    share_shown,
)
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import View
from debris_scanner.sim.session import SimulationSettings

SETTINGS = VerdictSettings()
EVERY = range(0, 126, 3)
COUNT = len(EVERY)


@pytest.fixture(scope='module')
def views(recording):
    return [recording.views[k] for k in EVERY]


@pytest.fixture(scope='module')
def poses(recording):
    return [recording.pose(k) for k in EVERY]


def judged(views, poses, inside=(), turn_deg=0.0, settings=SETTINGS, joined=None, followed=None):
    turn = transform(exp_so3(np.radians([0.0, turn_deg, 0.0])), np.zeros(3))
    off = [compose(turn, T) if k in inside else T for k, T in enumerate(poses)]
    linked = [k > 0 for k in range(COUNT)]
    none, every = [False] * COUNT, [True] * COUNT
    found = PosedKeyFrames(
        views, off, poses, linked, every if followed is None else followed, none if joined is None else joined
    )
    return judge_poses(found, typical_sensor(views), settings)


def test_true_poses_make_a_model(views, poses):
    verdict = judged(views, poses)
    assert (verdict.reason, verdict.dropped) == (None, ())
    gain, turning = verdict.checks
    assert gain[::2] == ('gain', SETTINGS.max_gain) and 0 <= gain.value < 0.05
    assert turning[::2] == ('turning_loss', SETTINGS.min_turning_loss)
    assert verdict.why == in_words(verdict.checks, f'{COUNT} key frames agree')


def test_a_few_key_frames_at_fault_are_left_out(views, poses):
    verdict = judged(views, poses, (20, 21), 6.0)
    assert verdict.reason is None
    assert set(verdict.dropped) == {20, 21}
    assert '2 that contradict them are left out' in verdict.why


def test_a_third_at_fault_is_no_model_and_is_named(views, poses):
    verdict = judged(views, poses, range(12, 26), 3.0)
    assert verdict.reason == INCONSISTENT_MODEL
    assert 'key frames' in verdict.why and f'of {COUNT} fit better turned by' in verdict.why
    gain, left_out = verdict.checks
    assert not gain.passed and gain.value > gain.bound == SETTINGS.max_gain
    assert not left_out.passed and left_out.name == 'left_out_share'


def test_a_half_turned_round_is_no_model(views, poses):
    verdict = judged(views, poses, range(COUNT // 2, COUNT), 180.0)
    assert verdict.reason == INCONSISTENT_MODEL
    assert 'fit better' in verdict.why


def test_what_gaps_and_left_out_key_frames_cut_off_is_turned_by_itself():
    followed = [True] * 7
    assert _parts([0, 1, 2, 3], followed) == [None]
    half, first, second = _parts([0, 1, 4, 5, 6], followed)
    assert half is None
    assert first.tolist() == [True, True, False, False, False]
    assert second.tolist() == [False, False, True, True, True]
    followed[2] = False
    assert [None if p is None else p.tolist() for p in _parts([1, 2, 3], followed)] == [
        None, [True, False, False], [False, True, True],
    ]  # fmt: skip


def test_where_a_turn_costs_too_little_it_is_not_observable(views, poses):
    verdict = judged(views, poses, settings=VerdictSettings(min_turning_loss=9.0))
    assert verdict.reason == UNOBSERVABLE_ROTATION
    (failed,) = (c for c in verdict.checks if not c.passed)
    assert failed[::2] == ('turning_loss', 9.0) and failed.value > SETTINGS.min_turning_loss
    assert 'the frames have no picture' in verdict.why


def test_what_the_colours_said_is_given_beside_the_shape(views, poses):
    assert judged(views, poses).value('colours') == np.inf  # there are none
    turn = SimulationSettings(target='cylinder', seconds=12.0, rate_hz=4.0, range_m=1.5, colour=True)
    painted = simulated(turn)[:COUNT]
    verdict = judged([View(frame) for frame, _ in painted], [T for _, T in painted])
    assert 0.03 < verdict.value('colours') < verdict.value('shape') < np.inf
    assert all(c.passed and c.bound is None for c in verdict.checks if c.name in {'colours', 'shape'})


def test_a_joined_part_that_could_lie_otherwise_is_no_model(views, poses, monkeypatch):
    later = np.arange(COUNT) >= COUNT // 2
    assert judged(views, poses, joined=later).reason is None
    monkeypatch.setattr(validation, 'least_joining_loss', lambda *_: 0.5 * SETTINGS.min_turning_loss)
    verdict = judged(views, poses, joined=later)
    assert verdict.reason == INCONSISTENT_MODEL
    assert [c.name for c in verdict.checks if not c.passed] == ['joining_loss']
    assert verdict.unplaced_ns == tuple(
        v.frame.stamp_ns for v, inside in zip(views, later, strict=True) if inside
    )


@pytest.mark.parametrize(
    ('frames', 'bound', 'reason'),
    [(0, 0.2, NO_TARGET), (5, 0.2, TOO_FEW_FRAMES), (40, 0.2, NO_CLOSURE), (40, 9.0, UNOBSERVABLE_ROTATION)],
)
def test_without_a_loop_there_is_a_reason(views, poses, frames, bound, reason):
    posed = PosedViews(views[:8], poses[:8], typical_sensor(views))
    verdict = judge_scan(frames, posed if frames else None, VerdictSettings(min_turning_loss=bound))
    assert verdict.reason == reason
    assert verdict.why
    failed = {NO_CLOSURE: 'closures', UNOBSERVABLE_ROTATION: 'turning_loss'}.get(reason, 'frames')
    assert [c.name for c in verdict.checks if not c.passed] == [failed]


@pytest.mark.parametrize(('frames', 'lost', 'reason'), [(9, 9, NO_CLOSURE), (9, 10, TOO_FEW_FRAMES)])
def test_a_target_that_was_seen_and_not_followed_is_told(views, poses, frames, lost, reason):
    posed = PosedViews(views[:8], poses[:8], typical_sensor(views))
    verdict = judge_scan(frames, posed, SETTINGS, lost)
    assert verdict.reason == reason
    if lost > frames:
        assert '19 frames showed a target' in verdict.why
        assert [c[:3] for c in verdict.checks] == [('frames_that_fit_none', 10, 9)]
        assert judge_scan(0, None, SETTINGS, 3).reason == TOO_FEW_FRAMES


def test_a_model_shows_more_than_a_side(views, poses):
    sensor = typical_sensor(views)
    whole, one = (
        share_shown(PosedViews(views, poses, sensor)),
        share_shown(PosedViews(views[:1], poses[:1], sensor)),
    )
    assert one == pytest.approx(0.25, abs=0.01)  # a cap of 60 degrees
    assert 0.75 < whole < 0.9
    few = PosedKeyFrames(views[:9], poses[:9], poses[:9], [k > 0 for k in range(9)], [True] * 9, [0] * 9)
    verdict = judge_poses(few, sensor, SETTINGS, final=True)
    assert verdict.reason == NO_CLOSURE
    assert 'the 9 key frames look at one side alone' in verdict.why
    assert [c.name for c in verdict.checks if not c.passed] == ['share_shown']
    assert judge_poses(few, sensor, SETTINGS).reason is None  # while a scan goes on, that is tracked by
