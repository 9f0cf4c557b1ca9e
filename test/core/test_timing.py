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

"""Stage timing: counts, percentiles, and a bounded memory."""

import time

import pytest

from debris_scanner.core import timing
from debris_scanner.core.timing import StageTimer


def test_summary_counts_and_ranks_the_samples():
    timer = StageTimer()
    for k in range(101):
        timer.add('match', k / 1000)
    timer.add('fuse', 0.5)
    assert timer.summary() == {
        'match': {'count': 101, 'p50_ms': 50.0, 'p99_ms': 99.0},
        'fuse': {'count': 1, 'p50_ms': 500.0, 'p99_ms': 500.0},
    }


def test_a_stage_is_timed_even_if_it_fails():
    timer = StageTimer()
    with pytest.raises(KeyError), timer.stage('broken'):
        time.sleep(0.02)
        raise KeyError
    row = timer.summary()['broken']
    assert row['count'] == 1
    assert row['p50_ms'] >= 20


def test_samples_are_bounded_but_all_are_counted(monkeypatch):
    monkeypatch.setattr(timing, 'WINDOW', 10)
    timer = StageTimer()
    for k in range(25):
        timer.add('match', k)
    assert timer.summary()['match'] == {'count': 25, 'p50_ms': 19500.0, 'p99_ms': 23910.0}


def test_nothing_timed_is_an_empty_summary():
    assert StageTimer().summary() == {}
