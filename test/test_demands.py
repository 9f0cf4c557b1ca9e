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
