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

"""Files for a public forge: they call what is there, ask for what helps, and name nobody who is not."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml

from tools.release import CHECKS

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / '.github' / 'workflows').glob('*.yml'))
TARGETS = set(re.findall(r'^([a-z]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))


def steps(path):
    """Each command of a workflow."""
    for job in yaml.safe_load(path.read_text())['jobs'].values():
        for step in job['steps']:
            yield from step.get('run', '').splitlines()


@pytest.mark.parametrize('path', WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_calls_what_is_there(path):
    ran = list(steps(path))
    assert ran
    for command in ran:
        words = shlex.split(re.sub(r'\$\{\{.*?\}\}', 'X', command))
        if words[0] == 'make':
            assert words[1] in TARGETS, command
        for module in re.findall(r'-m ((?:tools|benchmarks)[\w.]*)', command):
            place = ROOT / module.replace('.', '/')
            assert place.with_suffix('.py').is_file() or (place / '__main__.py').is_file(), command
        for names in re.findall(r'tools\.release --only (\S+)', command):
            assert set(names.split(',')) <= set(CHECKS)
    text = path.read_text()
    assert 'permissions:\n  contents: read' in text  # a pull request may not write
    assert 'secrets.' not in text


def test_both_pythons_the_container_wheels_docs_and_the_night_are_there():
    jobs = {name: job for path in WORKFLOWS for name, job in yaml.safe_load(path.read_text())['jobs'].items()}
    assert {'lint', 'test', 'ros', 'wheels', 'docs', 'faults', 'scorecard'} <= jobs.keys()
    for name in ('test', 'wheels'):
        assert jobs[name]['strategy']['matrix']['python'] == ['3.11', '3.12']


def test_a_commit_is_checked_as_make_lint_does():
    hooks = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text())['repos'][0]['hooks']
    recipe = re.search(r'^lint: setup\n((?:\t.*\n)+)', (ROOT / 'Makefile').read_text(), re.MULTILINE)[1]
    wanted = [line.strip().replace('$(VENV)', '.venv').removesuffix(' .') for line in recipe.splitlines()]
    assert [hook['entry'].replace(' --force-exclude', '') for hook in hooks] == wanted


@pytest.mark.parametrize('name', ['bug', 'question'])
def test_an_issue_asks_for_doctor_and_summary(name):
    form = yaml.safe_load((ROOT / '.github' / 'ISSUE_TEMPLATE' / f'{name}.yml').read_text())
    asked = {part['id']: part['attributes']['label'] for part in form['body'] if 'id' in part}
    assert 'debris-scan doctor' in asked['doctor']
    assert 'summary.json' in asked['summary']


def test_no_address_is_invented():
    """An address is of a reserved domain, until somebody who reads its mail puts in theirs."""
    names = [
        p.name
        for p in ROOT.glob('*.*')
        if p.is_file() and p.suffix in ('.md', '.xml', '.py', '.cff', '.toml')
    ]
    names += ['docs', '.github', 'launch']
    command = ['grep', '-rhoIE', r'[a-zA-Z0-9_.+-]+@[a-zA-Z0-9-]+(\.[a-z]{2,})+', *names]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    assert {
        a for a in found if not re.search(r'@(example\.(org|com|net)|.*\.(example|invalid))$', a)
    } == set()
    assert 'debris-scanner.dev' not in (ROOT / 'package.xml').read_text()
