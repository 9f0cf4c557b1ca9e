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

"""What the slider draws is the poses that were estimated."""

import base64
import dataclasses

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, from_pose_vector, transform
from debris_scanner.core.results import NO_CLOSURE, StampedPose
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.report.frame_view import MOST_FRAMES, frame_data, frame_view, window
from debris_scanner.report.scan_output import Surface, read_scan

TRIANGLE = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]]), np.array([[0, 1, 2]], np.int32)


def poses(n):
    return [
        StampedPose(10**8 * k, transform(exp_so3(np.array([0, 0.02 * k, 0])), np.array([0.1, 0, 0.8])))
        for k in range(n)
    ]


@pytest.fixture
def scan(tmp_path):
    write_results(
        tmp_path, ScanResult(NO_CLOSURE, None, odometry=poses(9), keyframe_poses=poses(9)[::4]), 1.0
    )
    return read_scan(tmp_path)


def unpacked(text, kind, *shape):
    return np.frombuffer(base64.b64decode(text), kind).reshape(*shape)


def test_poses_come_through(scan):
    data = frame_data(scan, poses(9))
    T = [from_pose_vector(v) for v in unpacked(data['poses'], '<f4', -1, 7).astype(float)]
    np.testing.assert_allclose(T, [p.T_sensor_target for p in poses(9)], atol=1e-6)
    np.testing.assert_allclose(unpacked(data['seconds'], '<f4', -1), 0.1 * np.arange(9), atol=1e-6)
    assert (data['numbers'], data['of'], data['keys']) == (list(range(1, 10)), 9, [0, 4, 8])
    assert 'vertices' not in data  # without a model the axes alone


def test_a_model_is_drawn_as_it_was_seen(scan):
    surface = Surface(*TRIANGLE, TRIANGLE[0], None, np.array([False]))
    data = frame_data(dataclasses.replace(scan, surface=surface), poses(9))
    np.testing.assert_allclose(unpacked(data['vertices'], '<f4', -1, 3), TRIANGLE[0], atol=1e-7)
    assert unpacked(data['triangles'], '<u4', -1).tolist() == [0, 1, 2]
    assert unpacked(data['observed'], 'u1', -1).tolist() == [0]
    assert data['axes'] == pytest.approx(0.2)


def test_all_frames_stay_within_the_window():
    left, right, top, bottom = window(np.array([[0.2, 0, 1.0], [-0.4, 0.1, 2.0]]), 0.1)
    assert left < -0.25 < 0.3 < right
    assert top < -0.1 < 0.1 < bottom


def test_a_long_scan_keeps_the_page_small(scan):
    data = frame_data(scan, poses(3 * MOST_FRAMES))
    assert len(data['numbers']) == MOST_FRAMES
    assert (data['numbers'][0], data['numbers'][-1]) == (1, data['of']) == (1, 3 * MOST_FRAMES)


def test_without_poses_there_is_no_slider(scan):
    assert 'type="range"' in frame_view(scan)
    assert frame_view(dataclasses.replace(scan, odometry=poses(1))) == ''
