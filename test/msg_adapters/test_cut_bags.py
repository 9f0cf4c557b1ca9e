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

"""Bags that a crash cut off: the intact part is used and said to be one; only nothing is refused."""

import shutil
import sqlite3

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from sessions import clouds, frames, images, mcap_bytes, ros1_active_bytes, write_rosbag1, write_rosbag2

from debris_scanner.core.frames import DepthFrame
from msg_adapters.bags import BagError, open_bag, open_session
from msg_adapters.errors import MalformedMessage

FRAMES = frames(40)
DEPTH = {f.stamp_ns: f.depth for f in FRAMES}
STAMPS = [f.stamp_ns for f in FRAMES]


def mcap_of(folder):
    return next(folder.glob('*.mcap')).read_bytes()


def ros1_of(tmp_path, compression=None):
    return write_rosbag1(tmp_path / 'whole.bag', clouds(FRAMES), compression).read_bytes()


def sqlite_of(tmp_path):
    return next(
        write_rosbag2(tmp_path / 'whole', clouds(FRAMES), StoragePlugin.SQLITE3).glob('*.db3')
    ).read_bytes()


# contents of a whole file, and the share of it before which not one message may be whole
FILES = {
    'mcap.mcap': (lambda p: mcap_of(write_rosbag2(p / 'whole', clouds(FRAMES))), 0.03),
    'chunks_zstd.mcap': (
        lambda p: mcap_of(write_rosbag2(p / 'whole', clouds(FRAMES), compression=CompressionMode.STORAGE)),
        0.15,
    ),
    'by_hand.mcap': (lambda p: mcap_bytes(clouds(FRAMES)), 0.03),
    'by_hand_lz4.mcap': (lambda p: mcap_bytes(clouds(FRAMES), 'lz4'), 0.15),
    'by_hand_zstd.mcap': (lambda p: mcap_bytes(clouds(FRAMES), 'zstd'), 0.15),
    'by_hand_without_chunks.mcap': (lambda p: mcap_bytes(clouds(FRAMES), per_chunk=0), 0.03),
    'sqlite.db3': (sqlite_of, 0.6),
    'ros1.bag': (ros1_of, 0.05),
    'ros1_bz2.bag': (lambda p: ros1_of(p, Writer1.CompressionFormat.BZ2), 0.3),
    'ros1_lz4.bag': (lambda p: ros1_of(p, Writer1.CompressionFormat.LZ4), 0.1),
}


def readable(path):
    """Stamps of the frames that can be read, checked to be those that were written."""
    with open_session(path) as session:
        read = list(session)
        assert session.count == len(read)
        assert session.warnings
        assert all('\n' not in line for line in session.warnings)
    for stamp, frame in read:
        assert isinstance(frame, DepthFrame)
        np.testing.assert_array_equal(frame.depth, DEPTH[stamp])
    return [stamp for stamp, _ in read]


@pytest.mark.parametrize('name', FILES)
def test_a_file_cut_anywhere_gives_its_intact_part(tmp_path, name):
    make, nothing_before = FILES[name]
    content = make(tmp_path)
    path = tmp_path / name
    most = 0
    for share in [*np.linspace(0.0, 1, 24, endpoint=False), 0.97, 0.995]:
        path.write_bytes(content[: int(len(content) * share)])
        try:
            stamps = readable(path)
        except BagError as error:
            assert str(path) in str(error)
            stamps = []
        assert stamps or share <= nothing_before
        if name != 'sqlite.db3':  # sqlite's pages are not in the order of its messages
            assert stamps == STAMPS[: len(stamps)]
            # what a crash costs is the message, or the compressed block, that it cut
            assert len(stamps) >= len(STAMPS) * (share - nothing_before)
        assert stamps == sorted(stamps)
        assert len(stamps) >= most
        most = len(stamps)
    assert most >= len(FRAMES) - (13 if 'bz2' in name else 8 if 'lz4' in name else 3)


@pytest.mark.parametrize('per_chunk', [0, 5])
@pytest.mark.parametrize('compression', ['', 'lz4', 'zstd'])
def test_an_mcap_without_index_is_whole_without_any_warning(tmp_path, compression, per_chunk):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(mcap_bytes(clouds(FRAMES), compression, per_chunk))
    with open_session(path) as session:
        assert [stamp for stamp, _ in session] == STAMPS
        assert session.warnings == []


def test_a_damaged_chunk_costs_only_itself(tmp_path):
    content = bytearray(mcap_bytes(clouds(FRAMES), 'zstd', per_chunk=4))
    inside = int(len(content) * 0.47)  # of the fifth of ten chunks
    content[inside : inside + 2000] = bytes(2000)
    path = tmp_path / 'bag.mcap'
    path.write_bytes(content[:-8])  # no index either
    stamps = readable(path)
    assert 36 <= len(stamps) < 40
    assert stamps[0] == STAMPS[0] and stamps[-1] == STAMPS[-1]


def test_messages_out_of_order_within_a_chunk_are_sorted(tmp_path):
    messages = clouds(FRAMES)
    messages[1], messages[3] = messages[3], messages[1]
    path = tmp_path / 'bag.mcap'
    path.write_bytes(mcap_bytes(messages)[:-50])
    assert readable(path) == STAMPS


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('compression', [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_a_folder_without_metadata_is_read_file_by_file(tmp_path, storage, compression):
    folder = write_rosbag2(tmp_path / 'bag', clouds(FRAMES), storage, compression)
    (folder / 'metadata.yaml').unlink()
    assert readable(folder) == STAMPS


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_metadata_that_promises_more_than_the_file_holds_is_not_believed(tmp_path, storage):
    folder = write_rosbag2(tmp_path / 'bag', clouds(FRAMES), storage)
    file = next(f for f in folder.iterdir() if f.suffix != '.yaml')
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * 0.9)])
    assert 30 <= len(readable(folder)) < 40


def test_a_folder_with_spoilt_metadata_is_read_file_by_file(tmp_path):
    folder = write_rosbag2(tmp_path / 'bag', clouds(FRAMES))
    for content in (
        b'',
        b'\xff\xfe',
        b'rosbag2_bagfile_information: 5',
        b'{',
        b'rosbag2_bagfile_information: {version: 9}',
    ):
        (folder / 'metadata.yaml').write_bytes(content)
        assert readable(folder) == STAMPS


def test_of_split_files_the_broken_one_costs_only_itself(tmp_path):
    folder = tmp_path / 'bag'
    folder.mkdir()
    messages = clouds(FRAMES)
    (folder / 'bag_0.mcap').write_bytes(mcap_bytes(messages[:20]))
    (folder / 'bag_1.mcap').write_bytes(b'')
    (folder / 'bag_2.mcap').write_bytes(mcap_bytes(messages[20:])[:-1000])
    assert readable(folder) == STAMPS[:39]
    with open_bag(folder) as bag:
        assert any('bag_1.mcap is empty' in line for line in bag.warnings)


def test_depth_images_are_salvaged_with_their_camera(tmp_path):
    path = tmp_path / 'bag.mcap'
    content = mcap_bytes(images(FRAMES), 'zstd')
    path.write_bytes(content[: len(content) // 2])
    assert len(readable(path)) >= 15


@pytest.mark.parametrize('metadata', [False, True])
def test_a_journal_that_was_never_merged_is_read(tmp_path, metadata):
    """sqlite3 in WAL mode keeps what a killed recorder wrote in a file beside the bag."""
    folder = write_rosbag2(tmp_path / 'source', clouds(FRAMES), StoragePlugin.SQLITE3)
    live = tmp_path / 'live.db3'
    file = next(folder.glob('*.db3'))
    shutil.copy(file, live)
    database = sqlite3.connect(live)
    rows = database.execute('SELECT id, topic_id, timestamp, data FROM messages ORDER BY id').fetchall()
    database.execute('DELETE FROM messages WHERE id > 10')
    database.commit()
    database.execute('PRAGMA journal_mode = WAL')
    database.execute('PRAGMA wal_autocheckpoint = 0')
    database.executemany('INSERT INTO messages VALUES (?, ?, ?, ?)', rows[10:])
    database.commit()
    crashed = tmp_path / 'crashed'
    crashed.mkdir()
    for suffix in ('', '-wal'):  # as a kill leaves them: copied while the recorder is still at it
        shutil.copy(f'{live}{suffix}', crashed / f'{file.name}{suffix}')
    if metadata:
        shutil.copy(folder / 'metadata.yaml', crashed)
    database.close()
    assert readable(crashed) == STAMPS


def test_the_recording_a_ros1_recorder_left_open_is_read(tmp_path):
    """A .bag.active has no index, and its last chunk says it is empty."""
    path = tmp_path / 'session.bag.active'
    content = ros1_active_bytes(clouds(FRAMES), opened=4)
    path.write_bytes(content)
    assert readable(path) == STAMPS
    path.write_bytes(content[:-100])
    assert readable(path) == STAMPS[:-1]


@settings(derandomize=True, deadline=None, max_examples=80)
@given(st.data())
def test_damage_anywhere_never_ends_in_a_traceback(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / 'damaged'
    folder.mkdir(exist_ok=True)
    kind = data.draw(st.sampled_from(sorted(SMALL)))
    content = bytearray(small(kind, tmp_path_factory))
    for _ in range(data.draw(st.integers(1, 6))):
        # headers and indices at both ends are where damage is treacherous
        at = data.draw(st.one_of(st.integers(0, len(content) - 1), st.integers(0, 300)))
        at = at if data.draw(st.booleans()) else len(content) - 1 - min(at, len(content) - 1)
        content[at : at + 1] = data.draw(st.binary(min_size=1, max_size=4))
    path = folder / kind
    path.write_bytes(content)
    try:
        with open_session(path) as session:
            for stamp, frame in session:
                assert isinstance(stamp, int)
                assert isinstance(frame, DepthFrame | MalformedMessage)
    except BagError as error:
        assert '\n' not in str(error)


SMALL = {
    'small.mcap': lambda p: mcap_of(write_rosbag2(p / 'small', images(FRAMES[:3]))),
    'small_zstd.mcap': lambda p: mcap_bytes(clouds(FRAMES[:3]), 'zstd', 2),
    'small.db3': lambda p: next(
        write_rosbag2(p / 's', images(FRAMES[:3]), StoragePlugin.SQLITE3).glob('*.db3')
    ).read_bytes(),
    'small.bag': lambda p: write_rosbag1(p / 's.bag', images(FRAMES[:3])).read_bytes(),
}
_made: dict[str, bytes] = {}


def small(kind, tmp_path_factory):
    if kind not in _made:
        _made[kind] = SMALL[kind](tmp_path_factory.mktemp('small'))
    return _made[kind]
