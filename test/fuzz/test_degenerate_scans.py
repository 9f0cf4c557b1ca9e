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

"""A slice of the degenerate scans: the whole of them is degenerate_scans.py."""

import subprocess
import sys
from random import Random

import degenerate_scans
import pytest
import run_fuzz


@pytest.mark.slow
def test_some_degenerate_scans_end_in_a_verdict():
    command = [sys.executable, run_fuzz.__file__, '--of', 'scans', '--cases', '100']
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert '100 cases (20 known, 2 merge, 78 scan) of seed 0' in done.stdout


@pytest.mark.parametrize('kind', ['scan', 'known'])
def test_a_case_is_the_same_every_time(kind):
    first, again = (degenerate_scans.run_case(kind, Random('0/3')) for _ in range(2))
    assert first == again


def test_an_exception_is_told_of(tmp_path, monkeypatch, capsys):
    def wrong(_):
        raise IndexError('beyond')

    note = tmp_path / 'note'
    note.write_bytes(bytes(8))
    monkeypatch.setattr(
        run_fuzz, 'case', lambda n, seed, of: (of, wrong if seed == 0 else lambda _: None, Random(n))
    )
    assert run_fuzz.work(0, 2, 0, note, 'scans') == 2
    assert capsys.readouterr().out.count('IndexError: beyond') == 2
