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

"""What real drivers send, from files that are not part of this repository."""

import numpy as np
import pytest
from pcd_files import cloud_of, read_pcd

from msg_adapters.clouds import read_cloud, read_fields
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.decoder import FrameDecoder, InputOptions

KINECT = {
    'capture0001.pcd': False,  # x y z
    'mOSD_learn0.pcd': True,  # label x y z rgba, x at offset 4
    'table_scene_mug_stereo_textured.pcd': True,  # x y z rgb as a float
}


@pytest.mark.parametrize('name', KINECT)
def test_kinect_clouds_are_read_exactly_and_tell_their_camera(shared_data, name):
    values, header = read_pcd(shared_data / 'kinect_clouds' / name)
    message = cloud_of(values, header)
    cloud = read_cloud(message)
    assert cloud.xyz.shape == (480, 640, 3)
    np.testing.assert_array_equal(
        cloud.xyz.reshape(-1, 3), np.stack([values[axis] for axis in 'xyz'], axis=-1)
    )
    assert (cloud.rgb is not None) == KINECT[name]
    if cloud.rgb is not None:
        word = values['rgba' if 'rgba' in values.dtype.names else 'rgb'].view('<u4').reshape(480, 640)
        for i, shift in enumerate((16, 8, 0)):
            np.testing.assert_array_equal(cloud.rgb[..., i], word >> shift & 255)


def test_a_kinects_cloud_becomes_a_depth_frame_with_its_camera(shared_data):
    values, header = read_pcd(shared_data / 'kinect_clouds' / 'mOSD_learn0.pcd')
    frame = FrameDecoder().cloud(cloud_of(values, header))
    assert frame.camera.fx == pytest.approx(525, abs=5)
    valid = np.isfinite(values['z'])
    np.testing.assert_array_equal(frame.depth.ravel()[valid], values['z'][valid])
    assert not frame.depth.ravel()[~valid].any()


def test_unaligned_lidar_points_are_read_exactly(shared_data):
    for path in sorted((shared_data / 'lidar_layouts').glob('*.pcd')):
        values, header = read_pcd(path)
        message = cloud_of(values, header)
        np.testing.assert_array_equal(
            read_cloud(message).xyz, np.stack([values[axis] for axis in 'xyz'], axis=-1)
        )
        for name, column in read_fields(message, values.dtype.names).items():
            np.testing.assert_array_equal(column, values[name])
        with pytest.raises(MalformedMessage, match='not an optical frame'):
            FrameDecoder().cloud(message)
        # no pinhole camera explains it: seen through the virtual one
        frame = FrameDecoder(InputOptions(axes='-y,-z,x')).cloud(message)
        assert (frame.depth > 0).sum() > 1000


def test_small_files_of_every_form_are_read(shared_data):
    read = 0
    for path in sorted((shared_data / 'pcd_edge_cases').glob('*.pcd')):
        try:
            values, header = read_pcd(path)
        except (KeyError, ValueError, IndexError):  # those made to be no PCD at all
            continue
        cloud = read_cloud(cloud_of(values, header))
        np.testing.assert_array_equal(
            cloud.xyz.reshape(-1, 3), np.stack([values[axis] for axis in 'xyz'], axis=-1)
        )
        read += 1
    assert read >= 6
