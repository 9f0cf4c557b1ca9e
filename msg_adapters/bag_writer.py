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

"""Writing a rosbag2 (mcap), completely or not at all."""

import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any

from rclpy.serialization import serialize_message

from debris_scanner.core.optional import Absent
from msg_adapters.errors import BagError
from msg_adapters.raw_messages import jazzy_types
from msg_adapters.stamps import read_stamp

try:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
except ImportError:
    CompressionFormat = CompressionMode = StoragePlugin = Writer = Absent('rosbags')


class BagWriter:
    """A new rosbag2 folder with one mcap file; a context manager.

    Everything is written into a temporary folder beside ``path`` and renamed at the end, so a crash or
    an error leaves no bag that looks complete. Files that belong to the bag, such as its truth, may be
    written into ``folder`` before the end.

    Args:
        path: the folder to make; must not exist, or be empty.
        compress: zstd compression of the chunks inside the mcap, which ``ros2 bag play`` reads as it is.

    Raises:
        BagError: the path is taken or cannot be written.
    """

    def __init__(self, path: str | Path, compress: bool = False) -> None:
        self.path = Path(path)
        if self.path.exists() and not (self.path.is_dir() and not any(self.path.iterdir())):
            msg = f'{self.path} exists already: name another, or remove it'
            raise BagError(msg)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._temporary = Path(tempfile.mkdtemp(prefix=f'.{self.path.name}.', dir=self.path.parent))
        except OSError as error:
            msg = f'{self.path} cannot be written: {error.strerror}'
            raise BagError(msg) from None
        # the folder has its final name already: rosbags names the mcap, and its metadata, after it
        self.folder = self._temporary / self.path.name
        self._writer = Writer(self.folder, version=9, storage_plugin=StoragePlugin.MCAP)
        if compress:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        self._connections: dict[tuple[str, str], Any] = {}

    def write(self, topic: str, message: Any, stamp_ns: int | None = None) -> None:
        """Write one of rclpy's messages; the bag's time is its header's stamp unless one is given."""
        kind = type(message)
        msgtype = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        stamp = read_stamp(message.header.stamp) if stamp_ns is None else stamp_ns
        self.write_raw(topic, msgtype, stamp, serialize_message(message))

    def write_raw(self, topic: str, msgtype: str, stamp_ns: int, data: bytes) -> None:
        """Write serialised (CDR) bytes of a type, as in ``sensor_msgs/msg/Image``, unchanged.

        Raises:
            BagError: the disk is full.
        """
        connection = self._connections.get((topic, msgtype))
        if connection is None:
            connection = self._writer.add_connection(topic, msgtype, typestore=jazzy_types())
            self._connections[topic, msgtype] = connection
        try:
            self._writer.write(connection, stamp_ns, data)
        except OSError as error:
            msg = f'{self.path} cannot be written: {error.strerror}'
            raise BagError(msg) from None

    def close(self) -> None:
        """Finish the bag and give it its name.

        Raises:
            BagError: the disk is full, or the path was taken meanwhile; nothing is left behind.
        """
        try:
            self._writer.close()
            for file in self.folder.iterdir():
                _sync(file)
            self.folder.rename(self.path)
            _sync(self.path.parent)
        except OSError as error:
            msg = f'{self.path} cannot be written: {error.strerror}'
            raise BagError(msg) from None
        finally:
            shutil.rmtree(self._temporary, ignore_errors=True)

    def abort(self) -> None:
        """Leave no bag behind."""
        self._writer.abort()
        shutil.rmtree(self._temporary, ignore_errors=True)

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def _sync(path: Path) -> None:
    """Bring a file or folder to the disk, so that a power cut cannot empty it after the rename."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
