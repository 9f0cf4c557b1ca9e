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

"""The noise of a scan's sensor, from its key frames."""

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.mapping.evidence import sensor_evidence
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings


def keyframes(recording, turn_deg=0.0):
    """A turn, each key frame posed off by so much more than the one before."""
    found = KeyFrameSet(NormalSettings())
    for n, k in enumerate(range(0, 126, 6)):
        off = transform(exp_so3(np.radians([0.0, turn_deg * n, 0.0])), np.zeros(3))
        found.add(KeyFrame(recording.targets[k], compose(off, recording.pose(k)), 0.05 * k))
    return found


def test_poses_that_are_off_do_not_matter(recording):
    right = sensor_evidence(keyframes(recording))
    drifting = sensor_evidence(keyframes(recording, 1.0))
    assert right.sigma_m == pytest.approx(0.0016, rel=0.2)  # a Kinect's at 0.75 m
    assert drifting.sigma_m == pytest.approx(right.sigma_m, rel=0.1)
    assert right.pairs == 8


def test_one_key_frame_tells_nothing(recording):
    alone = KeyFrameSet(NormalSettings())
    alone.add(KeyFrame(recording.targets[0], recording.pose(0), 0.0))
    assert sensor_evidence(alone) is None
