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

"""Recordings, folders and parameters that cannot be used, and those of which a part can."""

import itertools
import os
import shutil

import numpy as np
import pytest
from scan_runs import one_line, run, summary

from debris_scanner.scanner import Scanner
from debris_scanner.sim.depth_sensor import KINECT
from msg_adapters.bag_writer import BagWriter
from msg_adapters.bags import open_session
from msg_adapters.clouds import byte_array
from msg_adapters.depth_images import camera_info_message, depth_image_message, read_depth
from msg_adapters.stamps import time_message


def test_missing_bag(tmp_path, capsys):
    assert run(tmp_path / 'nowhere', tmp_path / 'out') == 2
    one_line(capsys, 'nowhere')


@pytest.mark.parametrize('name', ['bag.mcap', 'bag.db3', 'bag.bag', 'bag.txt'])
def test_garbage_file(tmp_path, capsys, name):
    (tmp_path / name).write_bytes(os.urandom(5000))
    assert run(tmp_path / name, tmp_path / 'out') == 2
    one_line(capsys, name)


def test_folder_without_a_bag(tmp_path, capsys):
    (tmp_path / 'folder').mkdir()
    assert run(tmp_path / 'folder', tmp_path / 'out') == 2
    one_line(capsys, 'folder')


def write_bag(path, images, with_info=True):
    """A bag of the images (stamp, message), each with its CameraInfo."""
    with BagWriter(path) as bag:
        for stamp, image in images:
            if with_info:
                bag.write('/depth/camera_info', camera_info_message(stamp, 'camera', KINECT), stamp)
            bag.write('/depth/image_raw', image, stamp)
    return path


@pytest.fixture(scope='module')
def images(session_bag):
    """The first frames of the session as images (stamp, message)."""
    with open_session(session_bag) as session:
        frames = [f for _, f in zip(range(12), (f for _, f in session), strict=False)]
    return [(f.stamp_ns, depth_image_message(f.stamp_ns, 'camera', f.depth, '16UC1')) for f in frames]


def test_bag_without_a_usable_topic_names_those_it_has(tmp_path, capsys, images):
    bag = write_bag(tmp_path / 'bag', images[:2], with_info=False)
    assert run(bag, tmp_path / 'out') == 2
    one_line(capsys, '/depth/image_raw', 'camera_info')


def test_topic_that_is_not_there(session_bag, tmp_path, capsys):
    assert run(session_bag, tmp_path / 'out', '--topic', '/camera/points') == 2
    one_line(capsys, '/camera/points', '/depth/image_raw')


def test_topic_may_be_named(tmp_path, images):
    bag = write_bag(tmp_path / 'bag', images)
    assert run(bag, tmp_path / 'out', '--topic', 'depth/image_raw') == 3
    assert summary(tmp_path / 'out')['frames']['used'] == 12


def test_malformed_messages_are_counted_and_the_scan_goes_on(tmp_path, images):
    damaged = []
    for k, (stamp, image) in enumerate(images):
        message = depth_image_message(stamp, 'camera', np.ones((480, 640), np.float32), '16UC1')
        if k in (3, 7):
            message.data = message.data[: 640 * 2 * 100]  # cut off after 100 rows
        damaged.append((stamp, message if k in (3, 7) else image))
    assert run(write_bag(tmp_path / 'bag', damaged), tmp_path / 'out') == 3
    frames = summary(tmp_path / 'out')['frames']
    assert frames == {'read': 12, 'used': 10, 'rejected': {'malformed': 2}}


def altered(images, pixels, encoding='32FC1'):
    """The images with their depth, metres, changed and packed anew."""
    packed = []
    for stamp, image in images:
        message = depth_image_message(stamp, 'camera', pixels(read_depth(image)).astype(np.float32), '32FC1')
        if encoding == '16UC1':
            raw = np.frombuffer(message.data, np.float32)
            message.encoding, message.step = encoding, 2 * message.width
            message.data = byte_array(np.nan_to_num(raw).astype(np.uint16))
        packed.append((stamp, message))
    return packed


def bag_of(path, images, camera):
    """A bag of images (stamp, message), all with the camera_info that ``camera`` makes of the right one."""
    with BagWriter(path) as bag:
        for stamp, image in images:
            bag.write('/depth/camera_info', camera(camera_info_message(stamp, 'camera', KINECT)), stamp)
            bag.write('/depth/image_raw', image, stamp)
    return path


def with_k(*k):
    """Makes camera_infos of that K."""

    def change(info):
        info.k = [float(number) for number in k]
        info.p = [float(number) for row in (k[:3], k[3:6], k[6:]) for number in (*row, 0)]
        return info

    return change


def of_another_size(info):
    info.width, info.height = 424, 240
    return info


@pytest.mark.parametrize(
    ('camera', 'values'),
    [
        (with_k(*[0] * 9), 'fx 0, fy 0'),
        (with_k(*[float('nan')] * 9), 'fx nan, fy nan'),
        (with_k(-525, 0, 320, 0, -525, 240, 0, 0, 1), 'fx -525, fy -525'),
        (with_k(1, 0, 320, 0, 1, 240, 0, 0, 1), 'fx 1, fy 1'),
        (of_another_size, 'camera_info is of 424x240, the image has 640x480'),
    ],
)
def test_a_wrong_camera_info_is_bad_input_and_its_values_are_named(tmp_path, capsys, images, camera, values):
    assert run(bag_of(tmp_path / 'bag', images, camera), tmp_path / 'out') == 2
    one_line(capsys, 'no model: camera_info', values, 'calibrate')
    told = summary(tmp_path / 'out')
    assert (told['result'], told['reason']) == ('no_model', 'camera_info')
    assert told['frames'] == {'read': 12, 'used': 0, 'rejected': {'camera_info': 12}}


def test_a_scan_goes_on_in_spite_of_a_wrong_camera_info(tmp_path, images):
    infos = itertools.chain([with_k(*[0] * 9)] * 2, itertools.repeat(lambda info: info))
    assert run(bag_of(tmp_path / 'bag', images, lambda info: next(infos)(info)), tmp_path / 'out') == 3
    told = summary(tmp_path / 'out')
    assert (told['reason'], 'hint' in told) == ('no_closure', False)
    assert told['frames'] == {'read': 12, 'used': 10, 'rejected': {'camera_info': 2}}


@pytest.mark.parametrize(
    ('pixels', 'encoding', 'hint'),
    [
        (lambda depth: depth * 1000, '32FC1', 'looks like millimetres in a format that is in metres'),
        (lambda depth: np.ceil(depth), '16UC1', 'looks like metres in a format that is in millimetres'),
        (np.zeros_like, '32FC1', 'no pixel has a depth'),
    ],
)
def test_depth_in_another_unit_is_hinted_at(tmp_path, capsys, images, pixels, encoding, hint):
    bag = write_bag(tmp_path / 'bag', altered(images, pixels, encoding))
    assert run(bag, tmp_path / 'out') == 3
    one_line(capsys, 'no model: no_target', hint)
    assert hint in summary(tmp_path / 'out')['hint']


def test_depth_with_shifted_bits_is_hinted_at_although_its_frames_are_used(tmp_path, capsys, images):
    bag = write_bag(tmp_path / 'bag', altered(images, lambda depth: 8 * np.rint(1000 * depth), '16UC1'))
    run(bag, tmp_path / 'out')
    told, said = summary(tmp_path / 'out'), 'nearly all depths are multiples of 8 mm'
    assert 2 * told['frames']['used'] > told['frames']['read']
    assert said in told['hint'] and f'warning: {said}' in capsys.readouterr().err


def test_stamps_that_are_all_0_are_hinted_at(tmp_path, capsys, images):
    for _, image in (unstamped := altered(images, lambda depth: depth)):
        image.header.stamp = time_message(0)
    assert run(write_bag(tmp_path / 'bag', unstamped), tmp_path / 'out') == 3
    one_line(capsys, 'all stamps are 0: the driver does not stamp its messages')
    assert summary(tmp_path / 'out')['frames']['rejected'] == {'non_monotone_stamp': 11}


def test_bag_cut_off_by_a_crash_is_used_to_its_last_whole_message(session_bag, tmp_path, capsys):
    shutil.copytree(session_bag, tmp_path / 'cut')
    file = tmp_path / 'cut' / 'shuttle_stack_spin.mcap'
    file.write_bytes(file.read_bytes()[:700_000])
    assert run(tmp_path / 'cut', tmp_path / 'out') == 3
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith('debris-scan scan: warning: ') and 'shuttle_stack_spin.mcap' in lines[0]
    assert lines[-1].startswith('debris-scan scan: no model: no_closure')
    assert len(lines) == 2
    assert 20 < summary(tmp_path / 'out')['frames']['used'] < 100


def test_bag_with_nothing_usable_left_is_refused(session_bag, tmp_path, capsys):
    shutil.copytree(session_bag, tmp_path / 'cut')
    file = tmp_path / 'cut' / 'shuttle_stack_spin.mcap'
    file.write_bytes(file.read_bytes()[:60])
    assert run(tmp_path / 'cut', tmp_path / 'out') == 2
    one_line(capsys, 'cut')


@pytest.mark.parametrize('name', ['file', 'file/below'])
def test_unwritable_out_is_told_before_the_scan(session_bag, tmp_path, capsys, monkeypatch, name):
    (tmp_path / 'file').write_text('not a folder')
    monkeypatch.setattr(Scanner, 'process', lambda *_: pytest.fail('scanned towards a folder that cannot be'))
    assert run(session_bag, tmp_path / name) == 2
    one_line(capsys, tmp_path / name)


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('isolation: {cluster_gaps: 16.0}', ['isolation.cluster_gaps', 'unknown']),
        ('isolation: {cluster_gap: 0.025}', ['isolation.cluster_gap', 'outside']),  # metres, once
        ('isolation: {cluster_gap: wide}', ['isolation.cluster_gap', 'float']),
        ('isolation: {box_min: [0.0, 0.0]}', ['isolation.box_min', '3 values']),
        ('isolation: [', ['cannot read']),
    ],
)
def test_bad_parameters(session_bag, tmp_path, capsys, text, words):
    params = tmp_path / 'params.yaml'
    params.write_text(f'/**:\n  ros__parameters:\n    {text}\n')
    assert run(session_bag, tmp_path / 'out', '--params', str(params)) == 2
    one_line(capsys, 'params.yaml', *words)


def test_missing_parameter_file(session_bag, tmp_path, capsys):
    assert run(session_bag, tmp_path / 'out', '--params', str(tmp_path / 'none.yaml')) == 2
    one_line(capsys, 'none.yaml')


def test_parameters_take_effect(tmp_path, images):
    params = tmp_path / 'params.yaml'
    params.write_text('/**:\n  ros__parameters:\n    isolation:\n      box_max: [0.4, 0.4, 0.5]\n')
    bag = write_bag(tmp_path / 'bag', images)
    assert run(bag, tmp_path / 'out', '--params', str(params)) == 3
    assert summary(tmp_path / 'out')['frames']['rejected'] == {'no_target': 12}
