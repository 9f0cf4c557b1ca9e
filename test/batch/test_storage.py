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

"""Places: folders that appear whole, digests of contents, one batch a folder, and the tables in them."""

import csv
import fcntl
import io
import json
import os

import fsspec
import pyarrow.parquet as pq
import pytest
from fsspec.implementations.local import LocalFileSystem

from debris_scanner.batch import BatchError
from debris_scanner.batch.inputs import find_recordings
from debris_scanner.batch.page import render
from debris_scanner.batch.storage import RECORD, Claim, Place, fetch, leftovers, records
from debris_scanner.batch.tables import COLUMNS, csv_bytes, parquet_bytes

ROWS = [
    {'name': 'a', 'result': 'model', 'frames_read': 250, 'rotation_period_s': 12.5, 'worker': 'lab-1, 2'},
    {'name': 'b', 'result': 'failed', 'reason': 'crashed: its process was ended by <SIGSEGV>', 'attempts': 2},
    {'name': 'c', 'result': 'pending', 'unknown': 1},
    {'name': 'd', 'result': 'bad_input', 'reason': 'not a bag'},
]


def folder(path, **files):
    path.mkdir(parents=True)
    for name, text in files.items():
        (path / name).write_text(text)
    return path


def test_a_folder_replaces_the_one_that_is_there(tmp_path):
    place = Place(str(tmp_path / 'out' / 'a'))
    place.publish(folder(tmp_path / 'first', x='1', y='2'))
    place.publish(folder(tmp_path / 'second', x='3'))
    assert {p.name: p.read_text() for p in (tmp_path / 'out' / 'a').iterdir()} == {'x': '3'}
    assert [p.name for p in (tmp_path / 'out').iterdir()] == ['a']


def test_a_folder_that_a_scan_writes_to_is_not_replaced(tmp_path):
    place = Place(str(tmp_path / 'out' / 'a'))
    place.publish(folder(tmp_path / 'first', x='1'))
    held = os.open(tmp_path / 'out' / 'a', os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)  # as another process would
    with pytest.raises(OSError, match='another scan'):
        place.publish(folder(tmp_path / 'second', x='2'))
    assert (tmp_path / 'out' / 'a' / 'x').read_text() == '1'
    os.close(held)


def test_what_a_killed_batch_left_is_found(tmp_path):
    for name in ('.a.0123.part', '.b.0123.old', '.git', 'c'):
        (tmp_path / name).mkdir()
    assert sorted(p.name for p in leftovers(Place(str(tmp_path)))) == ['.a.0123.part', '.b.0123.old']


class LabFileSystem(LocalFileSystem):
    """A file system whose host is no part of its paths, as ssh."""

    protocol = 'lab'

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(path.removeprefix('lab://user@host'))


def test_urls_keep_their_host_and_become_absolute(tmp_path, monkeypatch):
    fsspec.register_implementation('lab', LabFileSystem, clobber=True)
    (tmp_path / 'a.mcap').write_text('')
    (found,) = find_recordings([f'lab://user@host{tmp_path}'])
    assert found.url == found.files[0][1] == f'lab://user@host{tmp_path}/a.mcap'
    assert Place(f'lab://user@host{tmp_path}/out/').absolute == f'lab://user@host{tmp_path}/out'
    monkeypatch.chdir(tmp_path)
    assert Place('out').absolute == f'file://{tmp_path}/out'


def test_records_that_are_torn_do_not_count(tmp_path):
    for name, text in (('a', '{"key": 1}'), ('b', '{"torn'), ('c', '[]')):
        folder(tmp_path / name, **{RECORD: text})
    assert records(Place(str(tmp_path)), ['a', 'b', 'c', 'd']) == {'a': {'key': 1}}


def test_the_digest_is_of_contents_not_of_names_or_places(tmp_path):
    one, other = folder(tmp_path / 'x', **{'a.mcap': 'data'}), folder(tmp_path / 'y', **{'b.mcap': 'data'})
    split = folder(tmp_path / 'z', **{'a.mcap': 'da', 'b.mcap': 'ta'})
    digests = []
    for k, source in enumerate((one, other, split)):
        files = {p.name: Place(str(p)) for p in source.iterdir()}
        paths, sha, size = fetch(files, tmp_path / f'bag{k}')
        assert size == 4 and all(path.is_file() for path in paths.values())
        digests.append(sha)
    assert digests[0] == digests[1] != digests[2]


def test_one_batch_a_folder(tmp_path):
    out = Place(str(tmp_path / 'out'))
    with Claim(out):
        with pytest.raises(BatchError, match=r'another batch .*process') as caught, Claim(out):
            pass
        assert str(tmp_path) in str(caught.value)
    with Claim(out):
        pass


def test_a_file_in_the_way_is_one_line(tmp_path):
    (tmp_path / 'out').write_text('')
    with pytest.raises(BatchError, match='cannot write to'), Claim(Place(str(tmp_path / 'out'))):
        pass


def test_both_tables_say_the_same():
    table = pq.read_table(io.BytesIO(parquet_bytes(ROWS)))
    assert table.column_names == list(COLUMNS)
    assert table.column('frames_read').to_pylist() == [250, None, None, None]
    assert table.column('rotation_period_s').to_pylist() == [12.5, None, None, None]
    read = list(csv.DictReader(io.StringIO(csv_bytes(ROWS).decode())))
    for line, row in zip(read, table.to_pylist(), strict=True):
        assert {k: v or None for k, v in line.items()} == {
            k: None if v is None else str(v) for k, v in row.items()
        }


def test_the_page_has_a_line_a_recording():
    page = render(ROWS, 'lab & co')
    assert page.count('<tr data-result') == 4
    assert 'href="a/report.html"' in page and 'src="a/thumbnail.png"' in page
    assert 'href="_failed/b/log.txt"' in page and 'href="b/' not in page
    assert '&lt;SIGSEGV&gt;' in page and '<SIGSEGV>' not in page and 'lab &amp; co' in page
    assert 'href="d/log.txt"' in page and 'href="d/report' not in page
    assert '4 recordings: 1 bad input, 1 failed, 1 model, 1 pending' in page
    assert json.dumps('http') not in page and 'src="http' not in page
