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

from debris_scanner.io import files
from debris_scanner.io.files import CLAIM, FolderInUse, claimed, write_atomically


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


def test_a_claim_nests_and_ends(tmp_path):
    with claimed(tmp_path) as outer:
        with claimed(tmp_path / '.') as inner:
            assert inner == outer
        assert in_another_process(tmp_path) == 'in use'
    assert in_another_process(tmp_path) == 'had'
    with pytest.raises(FileNotFoundError), claimed(tmp_path / 'nothing'):
        pass


def test_a_claim_passes_to_children_that_inherit_it_and_lasts_as_long_as_they(tmp_path, monkeypatch):
    with claimed(tmp_path) as descriptor:
        monkeypatch.setenv(CLAIM, str(descriptor))
        assert in_another_process(tmp_path) == 'had'
        (tmp_path / 'other').mkdir()
        assert in_another_process(tmp_path / 'other') == 'had'
        inherited = os.dup(descriptor)
    monkeypatch.delenv(CLAIM)
    assert in_another_process(tmp_path) == 'in use'
    os.close(inherited)
    assert in_another_process(tmp_path) == 'had'


def in_another_process(folder):
    """Whether a process that knows of no claims can have a folder."""
    if (pid := os.fork()) == 0:
        code = 3
        try:
            files._held.clear()
            with claimed(folder):
                code = 0
        except FolderInUse:
            code = 1
        finally:
            os._exit(code)
    return {0: 'had', 1: 'in use'}[os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])]
