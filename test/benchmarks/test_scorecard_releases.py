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

"""A scorecard a release: what is kept of it, and what is drawn over the versions."""

import json

import pytest
from test_scorecard_outcome import CASES, record

from benchmarks.scorecard.outcome import RIGHT, WRONG_MODEL, score
from benchmarks.scorecard.releases import draw, read_releases, write_release

SPIN, STILL = CASES['cubesat-spin-s0'], CASES['shuttle_stack-still-s0']
REFUSED = score(STILL, record('no_closure'))


def test_a_release_keeps_outcomes_and_the_figures_of_models(tmp_path):
    path = write_release(tmp_path, '1.2.0', 'command', [score(SPIN, record(attitude=0.123456)), REFUSED])
    kept = json.loads(path.read_text())
    assert (kept['version'], kept['command'], kept['source']) == ('1.2.0', 'command', 'abc')
    assert kept['cases'] == {
        SPIN.name: {
            'outcome': RIGHT,
            'attitude_median_deg': 0.1235,
            'attitude_max_deg': 0.2469,
            'model_rmse_mm': 0.2,
            'completeness': 0.99,
        },
        STILL.name: {'outcome': RIGHT},
    }
    assert len(path.read_text().splitlines()) == 9  # a line a case: a change shows


def test_versions_are_drawn_in_their_order_by_the_cases_that_all_have(tmp_path):
    write_release(tmp_path, '0.10.0', 'c', [score(SPIN, record())])
    write_release(tmp_path, '0.9.0', 'c', [score(SPIN, record(verdict='wrong')), REFUSED])
    assert [release['version'] for release in read_releases(tmp_path)] == ['0.9.0', '0.10.0']
    assert read_releases(tmp_path)[0]['cases'][SPIN.name]['outcome'] == WRONG_MODEL
    drawn = draw(tmp_path).read_bytes()
    assert drawn.startswith(b'<?xml') and len(drawn) > 10_000
    assert draw(tmp_path).read_bytes() == drawn


def test_a_release_is_of_one_version_of_the_sources(tmp_path):
    with pytest.raises(ValueError, match='sources abc, def'):
        write_release(tmp_path, '1.0.0', 'c', [REFUSED, score(SPIN, record(source='def'))])
