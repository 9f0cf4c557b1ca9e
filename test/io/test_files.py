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

""""""

import os

import pytest

from debris_scanner.io.files import write_atomically


def test_writes_and_replaces(tmp_path):
    path = tmp_path / 'a.bin'
    write_atomically(path, b'first')
    write_atomically(path, b'second')
    assert path.read_bytes() == b'second'
    assert list(tmp_path.iterdir()) == [path]


def test_content_is_on_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    path = tmp_path / 'a.bin'
    seen = []
    real = os.fsync
    monkeypatch.setattr(os, 'fsync', lambda fd: (seen.append(path.exists()), real(fd)))
    write_atomically(path, b'x')
    assert seen == [False]


def test_failure_leaves_the_earlier_file_and_no_remains(tmp_path, monkeypatch):
    path = tmp_path / 'a.bin'
    write_atomically(path, b'first')

    def full(_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OSError, match='No space'):
        write_atomically(path, b'second')
    assert path.read_bytes() == b'first'
    assert list(tmp_path.iterdir()) == [path]
