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

import resource
import signal

import numpy as np
import pytest
from sessions import CAMERA, frames

from msg_adapters.bag_writer import BagWriter
from msg_adapters.bags import BagError, open_bag, open_session
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message

FRAMES = frames(6)


def record(path, compress=False):
    with BagWriter(path, compress) as bag:
        for frame in FRAMES:
            bag.write('/points', cloud_frame_message(frame, 's'))
            bag.write('/depth/image_raw', depth_image_message(frame.stamp_ns, 's', frame.depth, '16UC1'))
            bag.write('/depth/camera_info', camera_info_message(frame.stamp_ns, 's', CAMERA))
    return path


@pytest.mark.parametrize('compress', [False, True])
def test_what_is_written_is_read(tmp_path, compress):
    path = record(tmp_path / 'deep' / 'bag', compress)
    for topic in ('/points', '/depth/image_raw'):
        with open_session(path, topic) as session:
            read = list(session)
        assert [stamp for stamp, _ in read] == [f.stamp_ns for f in FRAMES]
        for (_, frame), expected in zip(read, FRAMES, strict=True):
            np.testing.assert_allclose(frame.depth, expected.depth, atol=0.0006)
    with open_bag(path) as bag:
        assert [m.stamp_ns for m in bag.messages({'/points'})] == [f.stamp_ns for f in FRAMES]
    assert sorted(f.name for f in path.iterdir()) == ['bag.mcap', 'metadata.yaml']
    assert [f.name for f in path.parent.iterdir()] == ['bag']


def test_compression_is_inside_the_mcap_so_that_every_player_reads_it(tmp_path):
    plain, packed = record(tmp_path / 'plain'), record(tmp_path / 'packed', compress=True)
    assert (packed / 'packed.mcap').stat().st_size < 0.95 * (plain / 'plain.mcap').stat().st_size
    assert (packed / 'packed.mcap').read_bytes().startswith(b'\x89MCAP0\r\n')
    metadata = (packed / 'metadata.yaml').read_text()
    assert "compression_mode: ''" in metadata


def test_an_error_leaves_nothing_behind(tmp_path):
    with pytest.raises(RuntimeError, match='half way'), BagWriter(tmp_path / 'bag') as bag:
        bag.write('/points', cloud_frame_message(FRAMES[0], 's'))
        raise RuntimeError('half way')
    assert list(tmp_path.iterdir()) == []


def test_until_it_is_whole_there_is_no_bag(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    bag.write('/points', cloud_frame_message(FRAMES[0], 's'))
    assert not (tmp_path / 'bag').exists()
    (bag.folder / 'truth.tum').write_text('0 0 0 0 0 0 0 1\n')
    bag.close()
    assert (tmp_path / 'bag' / 'truth.tum').read_text() == '0 0 0 0 0 0 0 1\n'


def test_an_existing_bag_is_not_overwritten(tmp_path):
    path = record(tmp_path / 'bag')
    with pytest.raises(BagError, match='exists already'):
        BagWriter(path)
    with open_session(path) as session:
        assert session.count == len(FRAMES)
    (tmp_path / 'file').write_text('mine')
    with pytest.raises(BagError, match='exists already'):
        BagWriter(tmp_path / 'file')


def test_an_empty_folder_may_be_filled(tmp_path):
    (tmp_path / 'bag').mkdir()
    with open_session(record(tmp_path / 'bag')) as session:
        assert session.count == len(FRAMES)


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot be written'):
        BagWriter(tmp_path / 'file' / 'bag')


def test_a_path_taken_meanwhile_is_left_alone(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    bag.write('/points', cloud_frame_message(FRAMES[0], 's'))
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'mine').write_text('mine')
    with pytest.raises(BagError, match='cannot be written'):
        bag.close()
    assert [f.name for f in tmp_path.iterdir()] == ['bag']
    assert (tmp_path / 'bag' / 'mine').read_text() == 'mine'


def test_a_full_disk_is_an_error_of_the_bag_and_leaves_nothing_behind(tmp_path):
    previous = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # so that writing too much is an OSError
    large = frames(1)[0]
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, previous[1]))
        with pytest.raises(BagError, match='cannot be written'), BagWriter(tmp_path / 'bag') as bag:
            for i in range(100):
                bag.write('/points', cloud_frame_message(large, 's'), i)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, previous)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []
