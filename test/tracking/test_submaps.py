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

"""Submaps: which frames become key frames, and which references a frame is registered to."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.submaps import Submaps, choose_references

SETTINGS = OdometrySettings()
SUBMAPS_SETTINGS = OdometrySettings(keyframe_angle_deg=8.0)
S = 1_000_000_000


@pytest.fixture
def known(recording):
    """One key frame, and the filter that it belongs to."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
    keyframes = KeyFrameSet(NormalSettings())
    T = np.linalg.inv(motion.T_sensor_target)
    keyframes.add(KeyFrame(recording.targets[0], T, 0.0, np.eye(6), 0), recording.views[0])
    return keyframes, motion


def turned(motion, deg, axis=(0.0, 1.0, 0.0)):
    other = motion.copy()
    other.R = exp_so3(np.radians(deg) * np.array(axis)) @ other.R
    return other


@pytest.mark.parametrize(
    ('deg', 'partial', 'expected'),
    [
        (10, False, ['key frame']),
        (10, True, ['key frame', 'partial']),
        (60, False, []),
        (60, True, ['key frame', 'partial']),  # it no longer serves alone, but reveals what is missing
        (80, True, ['partial']),
    ],
)
def test_what_serves(known, recording, deg, partial, expected):
    keyframes, motion = known
    half = [(recording.views[1], np.eye(4))] if partial else []
    chosen = choose_references(turned(motion, deg), keyframes, half, None, SETTINGS)
    names = {id(recording.views[0]): 'key frame', id(recording.views[1]): 'partial'}
    assert [names[id(surface)] for surface, _ in chosen] == expected


def test_no_key_frame_at_all(recording):
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
    half = [(recording.views[1], compose(transform(np.eye(3), np.zeros(3))))]
    assert choose_references(motion, KeyFrameSet(NormalSettings()), half, None, SETTINGS) == half
    assert choose_references(motion, KeyFrameSet(NormalSettings()), [], None, SETTINGS) == []


@pytest.fixture
def begun(recording):
    """The view of a first key frame, the submaps with it, and the filter that it was taken at."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
    submaps = Submaps(NormalSettings())
    submaps.add(recording.views[0], motion)
    return recording.views[0], submaps, motion


def test_by_turn(begun):
    view, submaps, motion = begun
    assert submaps.add_if_turned(view, turned(motion, 7), False, SUBMAPS_SETTINGS) is None
    keyframe = submaps.add_if_turned(view, turned(motion, 9), False, SUBMAPS_SETTINGS)
    assert keyframe.path_rad == pytest.approx(np.radians(9))
    assert submaps.scan_ns == view.frame.stamp_ns
    assert len(submaps.keyframes) == 2


def test_a_tracked_target_needs_them_for_new_sides_alone(begun):
    view, submaps, motion = begun
    rolled = turned(motion, 60, axis=(0.0, 0.0, 1.0))  # the same side
    assert submaps.add_if_turned(view, rolled, True, SUBMAPS_SETTINGS) is None
    assert submaps.add_if_turned(view, turned(motion, 60), True, SUBMAPS_SETTINGS).path_rad == 0.0


def test_submaps_count_together(begun):
    view, submaps, motion = begun
    few = dataclasses.replace(SUBMAPS_SETTINGS, max_keyframes=2)
    assert not submaps.full(few)
    submaps.begin(travelled=np.pi)
    assert len(submaps.keyframes) == 0 and submaps.number == 1
    first = submaps.add_if_turned(view, motion, False, few)  # however little it has turned
    assert (first.submap, first.path_rad) == (1, np.pi)
    assert submaps.full(few).startswith('2 key frames')
    assert submaps.add_if_turned(view, turned(motion, 90), False, few) is None


def test_age_is_that_of_the_current_submap(begun):
    view, submaps, _ = begun
    now = view.frame.stamp_ns + S
    assert submaps.younger(now, S + 1) and not submaps.younger(now, S)
    submaps.begin()
    assert not submaps.younger(now, 10 * S)  # it has not begun


def test_resumed(begun, recording):
    view, submaps, motion = begun
    frames = [submaps.add(view, motion)]
    submaps.begin(travelled=1.0)
    frames.append(submaps.add(recording.views[1], motion))
    other = Submaps(NormalSettings())
    other.resume(frames)
    assert (other.number, other.scan_ns) == (1, frames[0].stamp_ns)
    assert [k.stamp_ns for k in other.keyframes.frames] == [frames[1].stamp_ns]
    assert other.full(dataclasses.replace(SUBMAPS_SETTINGS, max_keyframes=2))
    assert other.add_if_turned(view, turned(motion, 9), False, SUBMAPS_SETTINGS).path_rad == pytest.approx(
        1 + np.radians(9)
    )
