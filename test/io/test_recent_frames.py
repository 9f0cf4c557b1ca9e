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

"""Frames on disk: as they were, the latest ones only, in order."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.io.journal import Record, decode, encode
from debris_scanner.io.recent_frames import RecentFrames, read_recent
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import pack_frame, pack_keyframe, unpack_frame, unpack_keyframe

NORMALS = NormalSettings()


def through_a_file(values):
    return decode(encode(Record('frame', values)))[0][0].values


def test_a_frame_comes_back_with_its_planes(recording):
    frame = recording.targets[3]
    back = unpack_frame(through_a_file(pack_frame(frame)), NORMALS)
    assert (back.stamp_ns, back.camera) == (frame.stamp_ns, frame.camera)
    for name in ('depth', 'depth_fit', 'normals'):
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    assert unpack_frame(through_a_file(pack_frame(frame, with_depth=False)), None).depth.size == 0


def test_a_distant_target_is_kept_too(recording):
    frame = recording.targets[0]
    far = type(frame)(1, frame.camera, frame.depth * 20, frame.depth_fit, frame.normals)
    np.testing.assert_allclose(unpack_frame(pack_frame(far), None).depth, far.depth, atol=4e-4)


def test_a_key_frame_comes_back(recording):
    colour = np.full((*recording.targets[5].depth.shape, 3), 77, np.uint8)
    frame = dataclasses.replace(recording.targets[5], rgb=colour)
    keyframe = KeyFrame(frame, recording.pose(5), 1.25, np.eye(6) * 3)
    back = unpack_keyframe(through_a_file(pack_keyframe(keyframe)), NORMALS)
    np.testing.assert_array_equal(back.T_target_sensor, keyframe.T_target_sensor)
    np.testing.assert_array_equal(back.covariance, keyframe.covariance)
    np.testing.assert_array_equal(back.frame.rgb, colour)
    assert back.path_rad == 1.25


@pytest.mark.parametrize('again', [False, True])
def test_the_latest_frames_stay(tmp_path, recording, again):
    writer = RecentFrames(tmp_path, segment_bytes=60_000)
    for k, frame in enumerate(recording.targets[:40]):
        if again and k == 33:  # the writer was killed
            writer = RecentFrames(tmp_path, segment_bytes=60_000)
        writer.append(frame, 'optical')
    stamps = [t.stamp_ns for t in recording.targets[:40]]
    kept = [frame.stamp_ns for frame, _ in read_recent(tmp_path, 0, NORMALS)]
    assert kept == stamps[-len(kept) :]
    assert 4 <= len(kept) < 20
    after = read_recent(tmp_path, stamps[-3], NORMALS)
    assert [(f.stamp_ns, frame_id) for f, frame_id in after] == [(s, 'optical') for s in stamps[-2:]]
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) < 2 * 80_000
    writer.restart()
    assert read_recent(tmp_path, 0, NORMALS) == []
