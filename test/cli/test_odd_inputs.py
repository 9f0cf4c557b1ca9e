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

"""Whatever is wrong with an input, a scan says so in one line, and nothing that was there is lost."""

from collections import Counter

import pytest
from odd_inputs import KINDS

from debris_scanner.cli.main import main


def test_there_are_two_hundred_kinds():
    assert len(KINDS) >= 200
    assert Counter(kind.name for kind in KINDS).most_common(1)[0][1] == 1


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
def test_odd_input_ends_in_one_line(tmp_path, capsys, kind):
    folder, out = tmp_path / 'in', tmp_path / 'out'
    folder.mkdir()
    out.mkdir()
    (out / 'notes.txt').write_text('kept')
    arguments = kind.arguments(folder)
    capsys.readouterr()
    try:
        code = main(['scan', *arguments, '--out', str(out)])
    except SystemExit as exit_:  # usage
        code = exit_.code
    said = capsys.readouterr().err
    last = said.strip().splitlines()[-1]
    assert code in (2, 3), said
    assert last.startswith('debris-scan scan: ') and 'Traceback' not in said
    assert len(last) > len('debris-scan scan: ') + 10
    assert code == 2 or (out / 'summary.json').exists()
    assert (out / 'notes.txt').read_text() == 'kept'
