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

"""The container file as far as it can be tried without an image."""

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LINES = (ROOT / 'Containerfile').read_text().replace('\\\n', ' ').splitlines()
STEPS = [line.removeprefix('RUN ') for line in LINES if line.startswith('RUN ')]


def extras():
    text = (ROOT / 'setup.py').read_text()
    return set(re.findall(r"^        '(\w+)': (?:\[|SCAN)", text, re.MULTILINE))


def test_it_builds_on_jazzy():
    assert [line for line in LINES if line.startswith('FROM ')] == [
        'FROM docker.io/library/ros:jazzy-ros-base'
    ]


@pytest.mark.parametrize('step', STEPS)
def test_each_step_parses_as_the_shell_reads_it(step):
    shell = shutil.which('dash') or 'sh'
    done = subprocess.run([shell, '-n', '-c', step], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_the_steps_name_exists():
    text = ' '.join(STEPS)
    named = re.search(r'/debris_scanner\[([\w,]+)\]', text).group(1).split(',')
    assert set(named) <= extras()
    for path in re.findall(r'src/debris_scanner/([\w.]+)', text):
        assert (ROOT / path).is_file(), path
    assert 'packages-select debris_scanner' in text
    ignored = (ROOT / '.containerignore').read_text().split()
    assert {'.git', '.venv', 'out'} <= set(ignored)


def test_the_entry_sources_ros_and_runs_what_it_is_given(tmp_path):
    (step,) = [s for s in STEPS if s.startswith('printf')]
    roots = {'/opt/ros/jazzy': tmp_path / 'ros', '/ws/install': tmp_path / 'ws', '/entry': tmp_path / 'entry'}
    for old, new in roots.items():
        step = step.replace(old, str(new))
    for name in ('ros', 'ws'):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'setup.bash').write_text(f'export SOURCED="$SOURCED {name}"\n')
    subprocess.run(['sh', '-c', step], check=True)
    command = [tmp_path / 'entry', 'sh', '-c', 'echo "$SOURCED:$1"', 'x', 'a b']
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == ' ros ws:a b\n'


def test_the_devcontainer_uses_it():
    given = json.loads((ROOT / '.devcontainer' / 'devcontainer.json').read_text())
    folder = ROOT / '.devcontainer'
    assert (folder / given['build']['dockerfile']).resolve() == ROOT / 'Containerfile'
    named = re.search(r'\.\[([\w,]+)\]', given['postCreateCommand']).group(1).split(',')
    assert set(named) <= extras()
    assert tomllib.loads((ROOT / 'pyproject.toml').read_text())
