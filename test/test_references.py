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

"""References: key frames seen from nearby; half hidden views, and then a witness from further away."""

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.submaps import choose_references

SETTINGS = OdometrySettings()


@pytest.fixture
def known(recording):
    """One key frame, and the filter that it belongs to."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings())
    keyframes = KeyFrameSet(NormalSettings())
    T = np.linalg.inv(motion.T_sensor_target)
    keyframes.add(KeyFrame(recording.targets[0], T, 0.0, np.eye(6), 0), recording.views[0])
    return keyframes, motion


def turned(motion, deg):
    other = motion.copy()
    other.R = exp_so3(np.array([0.0, np.radians(deg), 0.0])) @ other.R
    return other


@pytest.mark.parametrize(
    ('deg', 'partial', 'expected'),
    [
        (10, False, ['key frame']),
        (10, True, ['key frame', 'partial']),
        (60, False, []),
        (60, True, ['key frame', 'partial']),  # it no longer serves alone, but tells what is missing
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
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings())
    half = [(recording.views[1], compose(transform(np.eye(3), np.zeros(3))))]
    assert choose_references(motion, KeyFrameSet(NormalSettings()), half, None, SETTINGS) == half
    assert choose_references(motion, KeyFrameSet(NormalSettings()), [], None, SETTINGS) == []
