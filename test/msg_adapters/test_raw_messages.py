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

"""Decompression of cut-off and damaged streams, and the conversion of ROS 1 messages."""

import bz2

import lz4.frame
import numpy as np
import pytest
from backports import zstd

from msg_adapters import raw_messages as decompression
from msg_adapters.raw_messages import decompress_start

PACK = {
    'zstd': zstd.compress,
    'lz4': lambda data: lz4.frame.compress(data, block_linked=False, block_size=lz4.frame.BLOCKSIZE_MAX64KB),
    'bz2': lambda data: bz2.compress(data, 1),  # blocks of 100 kB
    '': bytes,
    'none': bytes,
}
DATA = np.random.default_rng(0).integers(0, 40, 1_000_000, dtype=np.uint8).tobytes()


@pytest.mark.parametrize('compression', PACK)
def test_what_is_whole_is_said_to_be(compression):
    assert decompress_start(compression, memoryview(PACK[compression](DATA))) == (DATA, True)


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'bz2'])
@pytest.mark.parametrize('share', [0.0, 0.3, 0.6, 0.999])
def test_of_a_cut_stream_all_whole_blocks_are_read(compression, share):
    packed = PACK[compression](DATA)
    start, whole = decompress_start(compression, memoryview(packed)[: int(share * len(packed))])
    assert not whole
    assert DATA.startswith(start)
    assert len(start) >= share * len(DATA) - 250_000


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'bz2'])
def test_what_came_before_the_damage_is_kept(compression):
    packed = bytearray(PACK[compression](DATA))
    packed[int(0.7 * len(packed)) :] = b'\xff' * (len(packed) - int(0.7 * len(packed)))
    start, whole = decompress_start(compression, memoryview(packed))
    assert not whole
    assert start[:400_000] == DATA[:400_000]


def test_of_an_unknown_compression_nothing_is_readable():
    assert decompress_start('brotli', memoryview(DATA)) == (b'', False)


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'bz2'])
def test_a_few_bytes_do_not_fill_the_memory(compression, monkeypatch):
    monkeypatch.setattr(decompression, '_LARGEST', 100_000)
    start, whole = decompress_start(compression, memoryview(PACK[compression](bytes(5_000_000))))
    assert len(start) <= 100_000
    assert not whole
