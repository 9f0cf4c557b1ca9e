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

"""Every demand of users has a test, and docs/demands.md names one that exists."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROWS = re.findall(r'^\| (\d+) \|.*\|(.*)\|$', (ROOT / 'docs' / 'demands.md').read_text(), re.MULTILINE)


def test_no_demand_is_left_out():
    assert [int(number) for number, _ in ROWS] == list(range(1, 22))


def test_the_tests_named_are_there():
    for number, tests in ROWS:
        named = re.findall(r'`([^`]+)::(\w+)`', tests)
        assert named, number
        for file, test in named:
            functions = {
                n.name for n in ast.parse((ROOT / file).read_text()).body if isinstance(n, ast.FunctionDef)
            }
            assert test in functions, f'{number}: {file}::{test}'
