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

"""ROS domains that are free, and processes that are started, checked and stopped."""

import os
import socket
import time

import pytest

from debris_scanner.cli.live.domain import DOMAINS, free_domain
from debris_scanner.cli.live.processes import BAD_INPUT, ChildFailed, Children, Respawn
from debris_scanner.nodes.lifecycle.process import PARENT


def test_a_domain_in_use_is_passed_over():
    first = free_domain(5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(('', 7400 + 250 * first))
        second = free_domain(5)
    assert second != first
    assert {first, second} <= set(DOMAINS)


@pytest.fixture
def node(tmp_path, monkeypatch):
    """Replaces the nodes' package by a module of the test's: what is tested is the handling of processes."""

    def make(code):
        folder = tmp_path / 'debris_scanner' / 'nodes'
        folder.mkdir(parents=True)
        (tmp_path / 'debris_scanner' / '__init__.py').write_text('')
        (folder / '__init__.py').write_text('')
        (folder / 'probe.py').write_text(code)
        monkeypatch.setenv('PYTHONPATH', str(tmp_path))
        monkeypatch.chdir(tmp_path)

    return make


def until(condition):
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_process_that_ends_is_reported_with_its_last_output(node, tmp_path):
    node('import sys; print("first"); print("the reason", file=sys.stderr); sys.exit(2)')
    with Children(tmp_path / 'logs') as children:
        children.start('probe')
        until(lambda: not children.running('probe'))
        with pytest.raises(
            ChildFailed, match=r'probe ended unexpectedly \(exit code 2\): the reason'
        ) as error:
            children.check(may_end=['probe'])
        assert error.value.code == 2


def test_a_folder_of_the_same_name_is_not_the_package(tmp_path, monkeypatch):
    """In the parent folder of a clone there is a folder debris_scanner, which is no package."""
    (tmp_path / 'debris_scanner' / 'nodes').mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    with Children(tmp_path / 'logs') as children:
        children.start('preprocess', ['--ros-args', '--params-file', 'missing.yaml'])
        until(lambda: not children.running('preprocess'))
        assert 'missing.yaml' in children.last_words('preprocess')


def test_one_that_may_end_is_no_failure(node, tmp_path):
    node('')
    with Children(tmp_path / 'logs') as children:
        children.start('probe')
        until(lambda: not children.running('probe'))
        children.check(may_end=['probe'])
        with pytest.raises(ChildFailed, match='exit code 0'):
            children.check()


def test_leaving_interrupts_and_knows_its_parent(node, tmp_path):
    node(
        'import os, time\n'
        f'print(os.environ["{PARENT}"], flush=True)\n'
        'try:\n    time.sleep(60)\nexcept KeyboardInterrupt:\n    print("saved", flush=True)\n'
    )
    log = tmp_path / 'logs' / 'probe.log'
    with Children(tmp_path / 'logs') as children:
        children.start('probe', ['--anything'])
        until(lambda: log.read_text())
        children.check()
    assert log.read_text().split() == [str(os.getpid()), 'saved']


def test_a_stage_is_watched_until_it_cannot_be_restarted(node, tmp_path):
    """A stage that dies between two checks is restarted by the next one; only one given up ends the scan."""
    node(f'import sys; sys.exit({BAD_INPUT})')
    with Children(tmp_path / 'logs') as children:
        children.start('probe')
        respawn = Respawn(children, ['probe'])
        until(lambda: not children.running('probe'))
        children.check(may_fail=respawn.watched)
        assert respawn.check() == []
        assert respawn.watched == []
        with pytest.raises(ChildFailed):
            children.check(may_fail=respawn.watched)
