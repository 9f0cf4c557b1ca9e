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

"""What README and tutorial print is run by `make release`; here how it is found, provided for and judged."""

import sys
from pathlib import Path

import pytest

from tools import commands

PROGRAMS = Path(sys.executable).parent


def test_somebody_tries_each_printed_command():
    found = [words for page in commands.PAGES for words in commands.printed(commands.ROOT / page)]
    assert {words[0] for words in found} == {'debris-scan', *commands.ELSEWHERE}
    assert sum(commands.waits(words) for words in found if words[0] == 'debris-scan') >= 4
    for place in commands.ELSEWHERE.values():
        assert not place.startswith('test/') or (commands.ROOT / place).is_file()


@pytest.mark.slow
def test_a_command_has_what_it_reads_and_is_judged_by_its_exit_code(tmp_path):
    said = commands.run(['debris-scan', 'import', 'FOLDER', '--out', 'BAG'], PROGRAMS, tmp_path)
    assert said.startswith('exit code 0') and (tmp_path / 'BAG' / 'metadata.yaml').is_file()
    with pytest.raises(commands.CommandFailed, match=r'exit code 2(.|\n)*does not exist'):
        commands.run(['debris-scan', 'scan', 'nowhere', '--out', 'out'], PROGRAMS, tmp_path)
    with pytest.raises(commands.CommandFailed, match='nobody tries'):
        commands.run(['brew', 'install', 'debris_scanner'], PROGRAMS, tmp_path)
    assert commands.run(['ros2', 'launch'], PROGRAMS, tmp_path).startswith('tried by test/')
