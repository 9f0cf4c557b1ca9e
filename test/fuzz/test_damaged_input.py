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

"""A slice of the fuzzing, and what drives it: the whole of it is run_fuzz.py."""

import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
import run_fuzz
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

DRIVER = Path(run_fuzz.__file__)


@pytest.mark.slow
def test_two_thousand_cases_come_to_nothing():
    done = subprocess.run(
        [sys.executable, DRIVER, '--cases', '2000'], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-6000:]
    assert '2000 cases (200 bag, 800 bytes, 1000 fields) of seed 0' in done.stdout


@pytest.mark.parametrize('kind', ['fields', 'bytes', 'bag'])
@settings(
    derandomize=True,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
)
@given(random=st.randoms(use_true_random=False))
def test_what_hypothesis_thinks_of(kind, random):
    """The same cases, but chosen, and made small when one fails, by hypothesis."""
    number = {'fields': 1, 'bytes': 2, 'bag': 0}[kind]
    name, run, _ = run_fuzz.case(number, 0)
    assert name == kind
    run(random)


def test_a_case_is_the_same_every_time():
    from bag_cases import bags
    from mutations import damaged

    content = bags()['MCAP_NONE']['MCAPNONE.mcap']
    first, again, other = (damaged(content, Random(f'0/{n}')) for n in (4, 4, 5))
    assert first == again != other


def test_a_failure_fails(tmp_path, monkeypatch, capsys):
    """An exception, a hang and a crash are all told of, and only they are."""
    note = tmp_path / 'note'
    note.write_bytes(bytes(8))

    def wrong(_):
        raise IndexError('beyond')

    monkeypatch.setattr(
        run_fuzz, 'case', lambda n, seed, of: ('x', wrong if n == 7 else lambda _: None, Random(n))
    )
    assert run_fuzz.work(3, 12, 0, note) == 1
    said = capsys.readouterr().out
    assert said.count('case ') == 1
    assert 'case 7 (x) of seed 0' in said and 'IndexError: beyond' in said
    assert run_fuzz.work(8, 12, 0, note) == 0
