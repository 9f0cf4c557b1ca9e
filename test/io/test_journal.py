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

"""Journals: what comes back after a kill, a torn end, a full disk."""

import errno
import os

import numpy as np
import pytest

from debris_scanner.io import journal as journal_module
from debris_scanner.io.journal import Journal, Record, StateSlot, decode, encode, read_records


def values(k):
    return {
        'n': k,
        'text': 'ä',
        'list': [1.5, None],
        'poses': np.eye(4) * k,
        'depth': np.arange(6, dtype='u2'),
    }


def fill(path, count):
    journal = Journal(path)
    for k in range(count):
        assert journal.append('frame', values(k), key=k)
    return journal


def test_records_come_back_as_they_were(tmp_path):
    path = tmp_path / 'folder' / 'a.journal'
    fill(path, 5).close()
    found = list(Journal(path).take_found())
    assert [r.key for r in found] == [0, 1, 2, 3, 4]
    for k, record in enumerate(found):
        assert record.kind == 'frame'
        assert record.values['text'] == 'ä'
        assert record.values['list'] == [1.5, None]
        np.testing.assert_array_equal(record.values['poses'], np.eye(4) * k)
        assert record.values['depth'].dtype == np.uint16
    assert [r.key for r in read_records(path, after=2)] == [3, 4]


@pytest.mark.parametrize('torn', [1, 7, 30])
def test_a_torn_end_is_cut_off_and_written_over(tmp_path, torn):
    path = tmp_path / 'a.journal'
    fill(path, 3).close()
    os.truncate(path, path.stat().st_size - torn)
    journal = Journal(path)
    assert [r.key for r in journal.take_found()] == [0, 1]
    journal.append('frame', values(9), key=9)
    journal.close()
    assert [r.key for r in read_records(path)] == [0, 1, 9]


def test_a_flipped_byte_ends_the_journal_there(tmp_path):
    first, second = (encode(Record('frame', values(k), k)) for k in range(2))
    for at in range(len(second)):
        damaged = bytearray(first + second)
        damaged[len(first) + at] ^= 0x55
        records, used = decode(bytes(damaged))
        assert [r.key for r in records] == [0], at
        assert used == len(first)
    assert read_records(tmp_path / 'missing') == []


def test_a_full_disk_is_said_and_the_next_record_is_whole(tmp_path, monkeypatch):
    path = tmp_path / 'a.journal'
    journal = fill(path, 2)
    write = os.pwrite

    def half(file, data, offset):
        write(file, data[: len(data) // 2], offset)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(journal_module.os, 'pwrite', half)
    assert not journal.append('frame', values(2), key=2)
    assert journal.problem == f'journal {path}: No space left on device'
    monkeypatch.setattr(journal_module.os, 'pwrite', write)
    assert journal.append('frame', values(3), key=3)
    assert journal.problem == ''
    assert [r.key for r in read_records(path)] == [0, 1, 3]


def test_a_journal_has_an_end(tmp_path):
    journal = Journal(tmp_path / 'a.journal', limit_bytes=2000)
    added = [journal.append('frame', {'noise': np.random.default_rng(k).bytes(99).hex()}) for k in range(50)]
    assert added[0]
    assert not added[-1]
    assert 'has reached' in journal.problem
    assert journal.path.stat().st_size <= 2000


def test_restart_begins_anew_even_where_the_file_was_removed(tmp_path):
    path = tmp_path / 'a.journal'
    journal = fill(path, 3)
    path.unlink()
    journal.restart()
    journal.append('frame', values(7), key=7)
    assert [r.key for r in read_records(path)] == [7]


def test_a_slot_keeps_the_last_whole_record(tmp_path):
    path = tmp_path / 'state'
    assert StateSlot.read(path) is None
    slot = StateSlot(path)
    for k in range(5):
        slot.write('filter', values(k))
    assert StateSlot.read(path).values['n'] == 4
    slot = StateSlot(path)  # the next process
    slot.write('filter', values(5))
    assert StateSlot.read(path).values['n'] == 5
    data = bytearray(path.read_bytes())
    data[StateSlot.SIZE + 40] ^= 1  # the write of the latest was torn
    path.write_bytes(data)
    assert StateSlot.read(path).values['n'] == 4
    with pytest.raises(ValueError, match='larger than a slot'):
        slot.write('filter', {'noise': np.random.default_rng(0).random(20_000)})
    slot.restart()
    assert StateSlot.read(path) is None
