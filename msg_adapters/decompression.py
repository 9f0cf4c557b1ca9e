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

"""Decompression that keeps what a cut-off or damaged stream held before its end."""

import bz2
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
from backports import zstd

_PIECE = 1 << 16
_LARGEST = 1 << 29  # bytes of one chunk; recorders write about one million, or one message


def decompress_start(compression: str, data: memoryview) -> tuple[bytes, bool]:
    """The readable start of a chunk, and whether that is all of it.

    Args:
        compression: '' or 'none', 'zstd', 'lz4' (frames) or 'bz2'; of any other nothing is readable.
        data: compressed bytes, perhaps cut off.
    """
    if compression in ('', 'none'):
        return bytes(data), True
    decompressor = _decompressor(compression)
    if decompressor is None:
        return b'', False
    pieces: list[bytes] = []
    size = 0
    for start in range(0, len(data), _PIECE):
        try:
            piece = decompressor.decompress(data[start : start + _PIECE], _LARGEST - size)
        except (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError):  # each library has its own
            break
        pieces.append(piece)
        size += len(piece)
        if decompressor.eof or size >= _LARGEST:  # a few bytes can be made to unpack to any length
            break
    return b''.join(pieces), bool(decompressor.eof)


def _decompressor(compression: str) -> Any:
    """A streaming decompressor: all three libraries share the interface."""
    if compression == 'zstd':
        return zstd.ZstdDecompressor()
    if compression == 'lz4':
        return lz4.frame.LZ4FrameDecompressor()
    if compression == 'bz2':
        return bz2.BZ2Decompressor()
    return None
