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

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.io.trajectories import TrajectoryFileError, read_tum, write_tum

LINE = '1.5 1 2 3 0 0 0 1'


def random_poses(stamps):
    rng = np.random.default_rng(0)
    return [StampedPose(s, transform(exp_so3(rng.normal(size=3)), rng.normal(size=3))) for s in stamps]


def test_round_trip_keeps_every_nanosecond(tmp_path):
    # as doubles of seconds these would lose their last digits
    stamps = [0, 1, 1_000_000_000, 1_763_725_887_123_456_789, 1_763_725_887_123_456_790]
    poses = random_poses(stamps)
    write_tum(tmp_path / 'a.tum', poses)
    back = read_tum(tmp_path / 'a.tum')
    assert [p.stamp_ns for p in back] == stamps
    for a, b in zip(poses, back, strict=True):
        np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-8)
    assert [p.name for p in tmp_path.iterdir()] == ['a.tum']


def test_the_line_is_seconds_position_and_scalar_last_quaternion(tmp_path):
    turned = transform(exp_so3(np.array([0, 0, np.pi / 2])), np.array([0.1, -0.2, 0.8]))
    write_tum(tmp_path / 'a.tum', [StampedPose(2_000_000_003, turned)])
    words = (tmp_path / 'a.tum').read_text().split()
    assert words[0] == '2.000000003'
    np.testing.assert_allclose(
        [float(w) for w in words[1:]], [0.1, -0.2, 0.8, 0, 0, 0.5**0.5, 0.5**0.5], atol=1e-9
    )


def test_comments_blank_lines_and_other_writers_numbers_are_read(tmp_path):
    path = tmp_path / 'a.tum'
    path.write_text('# t tx ty tz qx qy qz qw\n\n1.5e0 1 2 3 0 0 0 1.0001\n  2  0 0 0 0 0 0 -1\n')
    poses = read_tum(path)
    assert [p.stamp_ns for p in poses] == [1_500_000_000, 2_000_000_000]
    np.testing.assert_allclose(poses[0].T_sensor_target[:3, 3], [1, 2, 3])
    for pose in poses:
        np.testing.assert_allclose(pose.T_sensor_target[:3, :3], np.eye(3), atol=1e-12)


def test_an_empty_file_has_no_poses(tmp_path):
    write_tum(tmp_path / 'a.tum', [])
    assert read_tum(tmp_path / 'a.tum') == []


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('1.5 1 2 3 0 0 0', 'expected 8 numbers, found 7'),
        ('one 1 2 3 0 0 0 1', 'line 2'),
        ('nan 1 2 3 0 0 0 1', 'whole number of nanoseconds'),
        ('1.0000000001 1 2 3 0 0 0 1', 'whole number of nanoseconds'),
        ('1.5 1 2 x 0 0 0 1', "'x'"),
        ('1.5 1 2 inf 0 0 0 1', 'finite'),
        ('1.5 1 2 3 0 0 0 0', 'unit length'),
    ],
)
def test_bad_lines_are_named(tmp_path, line, message):
    (tmp_path / 'a.tum').write_text(f'{LINE}\n{line}\n')
    with pytest.raises(TrajectoryFileError, match=message) as caught:
        read_tum(tmp_path / 'a.tum')
    assert 'a.tum, line 2' in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryFileError, match=r'none\.tum'):
        read_tum(tmp_path / 'none.tum')
