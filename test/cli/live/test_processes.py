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
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from probes import run_probe

from debris_scanner.cli.live.domain import DOMAINS, free_domain
from debris_scanner.cli.live.processes import ChildFailed, Children, Respawn
from debris_scanner.io.files import FolderInUse, claimed


def test_a_domain_in_use_is_passed_over():
    first = free_domain(5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(('', 7400 + 250 * first))
        second = free_domain(5)
    assert second != first
    assert {first, second} <= set(DOMAINS)


@pytest.fixture
def children(tmp_path):
    """Processes of probes, ended at the end."""
    with Children(tmp_path / 'logs', run=run_probe) as started:
        yield started


def until(condition):
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_process_that_ends_is_reported_with_its_last_output(children):
    children.start('refuses')
    until(lambda: not children.running('refuses'))
    with pytest.raises(ChildFailed, match=r'refuses ended unexpectedly \(exit code 2\): the reason') as error:
        children.check(may_end=['refuses'])
    assert error.value.code == 2


def test_a_folder_of_the_same_name_is_not_the_package(tmp_path, monkeypatch):
    """In the parent folder of a clone there is a folder debris_scanner, which is no package."""
    (tmp_path / 'debris_scanner' / 'nodes').mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    with Children(tmp_path / 'logs') as children:
        children.start('preprocess', ['--ros-args', '--params-file', 'missing.yaml'])
        until(lambda: not children.running('preprocess'))
        assert 'missing.yaml' in children.last_words('preprocess')


def test_one_that_may_end_is_no_failure(children):
    children.start('ends')
    until(lambda: not children.running('ends'))
    children.check(may_end=['ends'])
    with pytest.raises(ChildFailed, match='exit code 0'):
        children.check()


def test_leaving_interrupts_and_knows_its_parent(tmp_path):
    log = tmp_path / 'logs' / 'saves.log'
    with Children(tmp_path / 'logs', run=run_probe) as children:
        children.start('saves')
        until(lambda: log.read_text())
        children.check()
    assert log.read_text().split() == [str(os.getpid()), 'saves', 'saved']


def test_what_is_killed_takes_its_processes_along(tmp_path):
    """And a process that was forked holds the lock of the folder as long as it runs."""
    log = tmp_path / 'logs' / 'saves.log'
    code = (
        'import os, signal, sys, time\n'
        'from pathlib import Path\n'
        'from debris_scanner.cli.live.processes import Children\n'
        'from debris_scanner.io.files import claimed\n'
        'from probes import run_probe\n'
        'with claimed(Path(sys.argv[1])) as lock:\n'
        '    children = Children(Path(sys.argv[1]) / "logs", lock, run=run_probe)\n'
        '    children.start("saves")\n'
        '    while not Path(sys.argv[2]).read_text():\n'
        '        time.sleep(0.02)\n'
        '    os.kill(os.getpid(), signal.SIGKILL)\n'
    )
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parents[3])))
    environment = os.environ | {'PYTHONPATH': paths}
    ended = subprocess.run([sys.executable, '-c', code, tmp_path, log], env=environment, check=False)
    assert ended.returncode == -signal.SIGKILL
    until(lambda: log.read_text().split()[2:] == ['alone'])
    until(lambda: free(tmp_path))


def free(folder):
    """Whether a folder's lock can be had."""
    try:
        with claimed(folder):
            return True
    except FolderInUse:
        return False


def test_a_stage_is_watched_until_it_cannot_be_restarted(children):
    """A stage that dies between two checks is restarted by the next one; only one given up ends the scan."""
    children.start('refuses')
    respawn = Respawn(children, ['refuses'])
    until(lambda: not children.running('refuses'))
    children.check(may_fail=respawn.watched)
    assert respawn.check() == []
    assert respawn.watched == []
    with pytest.raises(ChildFailed):
        children.check(may_fail=respawn.watched)
