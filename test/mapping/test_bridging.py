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

"""Where a target can be after a stretch out of sight."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.mapping.bridging import FreeMotion
from debris_scanner.sim.motions import MotionSettings, make_motion

STEP_S = 0.25
BEFORE, AFTER = 8, 8  # key frames
NS = 1e9


def recording(gap_s, motion='spin', seed=0):
    """Stamps and poses T_target_sensor of key frames before and after a gap; their part."""
    moving = make_motion(MotionSettings(motion, seed=seed, duration_s=60.0))
    t = np.concatenate([np.arange(BEFORE) * STEP_S, BEFORE * STEP_S + gap_s + np.arange(AFTER) * STEP_S])
    poses = [np.linalg.inv(moving.T_sensor_target(s)) for s in 10.0 + t]
    return (t * NS).astype(np.int64).tolist(), poses, np.arange(len(t)) >= BEFORE


def turned(poses, part, degrees, axis):
    T = transform(exp_so3(np.radians(degrees) * np.eye(3)[axis]), np.zeros(3))
    return [T @ P if inside else P for P, inside in zip(poses, part, strict=True)]


def tracked(part):
    return [k > 0 and part[k] == part[k - 1] for k in range(len(part))]


@pytest.mark.parametrize('gap_s', [0.5, 2.0, 5.0])
@pytest.mark.parametrize('motion', ['spin', 'tumble'])
@pytest.mark.parametrize('seed', range(4))
def test_a_free_body_turns_where_its_rates_lead(motion, gap_s, seed):
    stamps, poses, part = recording(gap_s, motion, seed)
    bridge = FreeMotion(stamps, tracked(part), tracked(part)).worst_bridge(poses, part)
    assert bridge.leads_here
    assert bridge.gap_s == pytest.approx(gap_s + STEP_S)
    assert bridge.off < 1.2 * bridge.known + np.radians(1.0)


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('motion', ['spin', 'tumble'])
@pytest.mark.parametrize('seed', range(4))
def test_another_face_is_told_from_the_right_one(motion, axis, seed):
    stamps, poses, part = recording(2.0, motion, seed)
    motion = FreeMotion(stamps, tracked(part), tracked(part))
    assert motion.leads(poses, part)
    assert not motion.leads(turned(poses, part, 180.0, axis), part)


def test_long_out_of_sight_a_tumbling_target_may_be_anywhere():
    stamps, poses, part = recording(25.0, 'tumble')
    motion = FreeMotion(stamps, tracked(part), tracked(part))
    assert all(motion.leads(turned(poses, part, d, 2), part) for d in range(0, 360, 45))


def test_in_sight_and_without_rates_nothing_is_known():
    stamps, poses, part = recording(2.0)
    wrong, linked = turned(poses, part, 180.0, 0), tracked(part)
    assert FreeMotion(stamps, linked, [True] * len(part)).worst_bridge(wrong, part) is None
    assert FreeMotion(stamps, [False] * len(part), linked).worst_bridge(wrong, part) is None
    assert FreeMotion(stamps, linked, linked).worst_bridge(wrong, np.zeros(len(part), int)) is None


def test_a_bridge_says_its_numbers():
    stamps, poses, part = recording(2.0)
    motion = FreeMotion(stamps, tracked(part), tracked(part))
    turn, gap = motion.worst_bridge(turned(poses, part, 180.0, 0), part).checks
    assert (turn.name, turn.passed) == ('off_motion_deg', False)
    assert 100 < turn.value < 180.1 and 15 < turn.bound < turn.value
    assert (gap.name, gap.value) == ('out_of_sight_s', pytest.approx(2.2, abs=0.05))
    assert motion.worst_bridge(poses, part).checks[0].passed
