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

"""An odometry that is killed between any two frames goes on as if nothing had happened."""

import numpy as np
import pytest

from debris_scanner.core.geometry import rotation_angle
from debris_scanner.io.journal import StateSlot
from debris_scanner.io.odometry_journal import RECORDS, STATE, OdometryJournal, read_scan_keyframes
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import SCANNING, TRACKING, Odometry

NORMALS = NormalSettings()
FRAMES = 40


@pytest.fixture(scope='module')
def whole(coarse_recording, tmp_path_factory):
    """Estimates of an odometry that nobody kills."""
    journal = OdometryJournal(tmp_path_factory.mktemp('whole'), NORMALS)
    return scan(fresh(), journal, coarse_recording.targets[:FRAMES])


def fresh():
    return Odometry(Settings().odometry, Settings().motion, NORMALS)


def scan(odometry, journal, frames):
    estimates = []
    for frame in frames:
        estimates.append(odometry.process(frame))
        journal.note(odometry, estimates[-1])
    return estimates


def adopt(odometry, journal, model, recording):
    poses = {k.stamp_ns: recording.pose(n) for n, k in known(odometry, recording)}
    odometry.adopt_model(model, poses)
    journal.adopted(odometry)


def known(odometry, recording):
    index = {t.stamp_ns: n for n, t in enumerate(recording.targets)}
    return [(index[k.stamp_ns], k) for k in odometry.keyframes.frames]


@pytest.mark.parametrize('killed_after', [1, 2, 17, 30])
def test_scanning_goes_on_with_the_same_numbers(tmp_path, coarse_recording, whole, killed_after):
    frames = coarse_recording.targets[:FRAMES]
    scan(fresh(), OdometryJournal(tmp_path / 'cut', NORMALS), frames[:killed_after])
    second, journal = fresh(), OdometryJournal(tmp_path / 'cut', NORMALS)
    assert journal.resume(second)
    rest = scan(second, journal, frames[killed_after:])
    for a, b in zip(whole[killed_after:], rest, strict=True):
        np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-12)
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9)
        assert (a.state, a.accepted, a.keyframe is None) == (b.state, b.accepted, b.keyframe is None)
    scanned = read_scan_keyframes(tmp_path / 'cut', 0, NORMALS)
    assert [k.stamp_ns for k in scanned] == [e.stamp_ns for e in whole if e.keyframe is not None]
    assert [k.path_rad for k in scanned] == [e.keyframe.path_rad for e in whole if e.keyframe is not None]


def test_tracking_goes_on(tmp_path, recording, true_model):
    first, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    scan(first, journal, recording.targets[:30])
    adopt(first, journal, true_model, recording)
    scan(first, journal, recording.targets[30:35])
    second, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    assert journal.resume(second)
    assert second.state == TRACKING
    for k, estimate in enumerate(scan(second, journal, recording.targets[35:40]), start=35):
        assert estimate.accepted
        assert estimate.state == TRACKING
        assert rotation_angle(estimate.T_sensor_target[:3, :3] @ recording.pose(k)[:3, :3]) < 0.01


def test_a_model_that_was_dropped_stays_so(tmp_path, recording, true_model):
    first, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    scan(first, journal, recording.targets[:30])
    adopt(first, journal, true_model, recording)
    scan(first, journal, recording.targets[30:32])
    first.drop_model()
    journal.adopted(first)
    last = scan(first, journal, recording.targets[32:36])[-1]
    assert (last.state, last.tracked) == (SCANNING, False)
    second, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    assert journal.resume(second)
    (estimate,) = scan(second, journal, recording.targets[36:37])
    assert (estimate.state, estimate.tracked, estimate.accepted) == (SCANNING, False, True)
    assert estimate.submap == last.submap > 0
    assert estimate.scan_ns == recording.targets[0].stamp_ns


def test_killed_between_the_model_and_the_filter(tmp_path, recording, true_model):
    """The filter is that of before the model, so the key frames are too; the model comes by its topic."""
    first, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    estimates = scan(first, journal, recording.targets[:20])
    before = (tmp_path / STATE).read_bytes()
    adopt(first, journal, true_model, recording)
    (tmp_path / STATE).write_bytes(before)
    second, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    assert journal.resume(second)
    assert second.state == SCANNING
    np.testing.assert_allclose(second.filter.T_sensor_target, estimates[-1].T_sensor_target)
    np.testing.assert_allclose(second.keyframes.frames[-1].T_target_sensor, first_pose(estimates))
    adopt(second, journal, true_model, recording)
    assert StateSlot.read(tmp_path / STATE).values['adoptions'] == 1


def first_pose(estimates):
    return next(e.keyframe.T_target_sensor for e in reversed(estimates) if e.keyframe is not None)


def test_a_pose_found_by_appearance_alone_stays_so(tmp_path, recording):
    first, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    scan(first, journal, recording.targets[:5])
    first.consistent_with_prediction = False
    scan(first, journal, recording.targets[5:6])
    second, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    assert journal.resume(second)
    (estimate,) = scan(second, journal, recording.targets[6:7])
    assert estimate.accepted
    assert not estimate.usable_for_mapping


def test_nothing_to_go_on_from(tmp_path, recording):
    assert not OdometryJournal(tmp_path, NORMALS).resume(fresh())
    odometry, journal = fresh(), OdometryJournal(tmp_path, NORMALS)
    scan(odometry, journal, recording.targets[:5])
    journal.restart()
    assert not OdometryJournal(tmp_path, NORMALS).resume(fresh())
    scan(fresh(), journal, recording.targets[:5])
    (tmp_path / RECORDS).unlink()
    assert not OdometryJournal(tmp_path, NORMALS).resume(fresh())
