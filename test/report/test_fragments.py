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

"""Pieces of the page."""

import numpy as np

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import NO_CLOSURE, Check, ClosureRecord, at_least, at_most
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.report.fragments import closure_table, figures_table, verdict
from debris_scanner.report.scan_output import read_scan


def test_the_closure_table_shows_the_registered_pose(tmp_path):
    T = transform(exp_so3(np.array([0, 0, np.radians(7.5)])), np.array([0.1, -0.2, 0.03]))
    closures = [
        ClosureRecord(
            1, 2, 0.5, False, 'words', T, (at_least('overlap', 0.3, 0.4), Check('correction_deg', 12.5))
        ),
        ClosureRecord(1, 3, 0.5, False, 'the views do not overlap'),
    ]
    write_results(tmp_path, ScanResult(NO_CLOSURE, None, closures=closures), 1.0)
    table = closure_table(read_scan(tmp_path))
    registered, unmet = table.split('<tbody>')[1].split('</tr>')[:2]
    assert (
        'title="T_from_to 0.100000 -0.200000 0.030000 0.000000 0.000000 0.065403 0.997859">7.50<'
        in registered
    )
    assert 'T_from_to' not in unmet and '<td>–</td>' in unmet
    assert 'overlap 0.30 not ≥ 0.40' in registered
    assert '<td>0.300</td><td>12.500</td>' in registered
    assert 'the views do not overlap' in unmet


def test_the_verdict_shows_its_checks(tmp_path):
    checks = (at_most('gain', 0.3, 0.15), at_least('turning_loss', 0.9, 0.2))
    write_results(tmp_path, ScanResult(NO_CLOSURE, None, checks=checks), 1.0)
    scan = read_scan(tmp_path)
    assert scan.checks == checks
    shown = verdict(scan)
    assert '✗ gain 0.30 not &lt;= 0.15' in shown and '✓ turning loss 0.90 &gt;= 0.20' in shown


def test_the_figures_say_where_closures_were_judged_by_attitude():
    closures = {'precision': 1.0, 'recall': 0.5, 'false': 0}
    for judged_by, said in (('pose', False), ('attitude', True)):
        shown = figures_table({'closures': closures, 'closures_by': judged_by})
        assert '0 false' in shown and ('judged by attitude' in shown) is said
    assert 'judged by' not in figures_table({'closures': closures})  # of an earlier release
