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

"""The linters of a ROS 2 workspace, where their commands are installed: in ``colcon test`` and in CI."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
INSTALLED = ('debris_scanner', 'msg_adapters', 'launch', 'setup.py')
# tests, nodes and constructors speak by their names, as in pyproject.toml; formulas are no signatures
# (D402), CameraInfo is no slip (D403)
NOT_ASKED = ('D100', 'D101', 'D102', 'D103', 'D104', 'D105', 'D107', 'D402', 'D403')


def lint(linter, *arguments):
    """Run one of ament's linters in the root of the sources; fails with what it found."""
    command = shutil.which(linter)
    if command is None:
        pytest.skip(f'no {linter}: apt-get install python3-{linter.replace("_", "-")}')
    # the linters have an interpreter of their own, which this environment's start-up hooks are not meant for
    ours = {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}
    found = subprocess.run([command, *arguments], cwd=ROOT, env=ours, text=True, capture_output=True)
    assert found.returncode == 0, found.stdout + found.stderr


def test_copyright():
    lint('ament_copyright', *INSTALLED, 'test', 'benchmarks', 'docs')


def test_flake8():
    lint('ament_flake8', '--config', 'setup.cfg', *INSTALLED)


def test_pep257():
    lint('ament_pep257', '--convention', 'google', '--add-ignore', *NOT_ASKED, '--', *INSTALLED)


def test_xmllint():
    if shutil.which('xmllint') is None:
        pytest.skip('no xmllint: apt-get install libxml2-utils')
    lint('ament_xmllint', 'package.xml', 'debris_scanner/nodes')
