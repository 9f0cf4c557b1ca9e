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

"""The bench's tables, and how they get into the document."""

import pytest

from benchmarks.performance.measure import Cost, Row
from benchmarks.performance.report import number, ratios, table, write_section


def row(who, ms, note=''):
    return Row('pair', who, Cost.of([ms]), note)


def test_ratios_stand_before_the_note():
    found = ratios([row('PCL', 50.0, '0.2°'), row('half', 2.5)], 5.0)
    assert [r.note for r in found] == ['10 x ours; 0.2°', '0.50 x ours']


def test_a_table_has_a_row_each_and_even_columns():
    lines = table([row('ours', 7.26), row('PCL: voxel grid', 272.9, 'slow')]).splitlines()
    assert len(lines) == 4
    assert len({len(line) for line in lines}) == 1
    assert '273' in lines[3] and '7.26' in lines[2]


@pytest.mark.parametrize(
    ('ms', 'text'), [(0.00433, '0.00433'), (7.256, '7.26'), (99.0, '99'), (2476404, '2476404')]
)
def test_numbers_have_three_digits_and_no_exponent(ms, text):
    assert number(ms) == text


def test_a_section_is_replaced_and_the_rest_stays(tmp_path):
    document = tmp_path / 'd.md'
    document.write_text('before\n<!-- a -->\nold\n<!-- end a -->\nbetween\n<!-- b -->\n<!-- end b -->\n')
    write_section(document, 'a', r'new \1')
    write_section(document, 'a', 'newer')
    assert document.read_text() == (
        'before\n<!-- a -->\n\nnewer\n\n<!-- end a -->\nbetween\n<!-- b -->\n<!-- end b -->\n'
    )
    with pytest.raises(ValueError, match='no section'):
        write_section(document, 'c', '')
