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

"""``debris-scan live`` as a process that a test disturbs while it runs."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil

from debris_scanner.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ('play_bag', 'sim_kinect', 'freenect_camera', 'openni2_camera')
NODES = ('preprocess', 'odometry', 'closure', 'graph', 'scanner', 'viewer', *SOURCES)


def command(*arguments):
    return [sys.executable, '-m', 'debris_scanner', *map(str, arguments)]


def environment():
    """Without a domain of the caller's: live chooses one."""
    return {k: v for k, v in os.environ.items() if k != 'ROS_DOMAIN_ID'} | {'PYTHONPATH': str(ROOT)}


def run(*arguments, timeout=170):
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, timeout=timeout, env=environment()
    )


def assert_kept_up(summary, speed):
    """A 10 Hz recording played fast: few frames are shed while a model is made, and it is tracked after that.

    At most half of those that come in meanwhile, and at least a fifth of those that come later: how long a
    model takes the machine decides.
    """
    frames, timing = summary['frames'], summary['timing']
    shed = frames['rejected'].get('shed', 0)
    while_made = 10.0 * speed * timing['closure_to_model']['p50_ms'] / 1000
    closure = next(c for c in summary['closures'] if c['accepted'])  # with the first frame
    before = 10.0 * (closure['to_stamp_ns'] - closure['from_stamp_ns']) / 1e9
    assert shed <= 0.5 * while_made
    assert frames['read'] - frames['used'] - shed <= 5
    tracked = timing.get('tracking', {'count': 0})['count']
    assert tracked >= 0.2 * (frames['read'] - before - while_made)


def summary_of(out):
    return json.loads((out / 'summary.json').read_text())


def refused(capfd, *arguments):
    """What ``live`` says, in one line, of input that it can't use."""
    try:
        code = main(['live', *arguments])
    except SystemExit as ended:  # argparse
        code = ended.code
    assert code == 2
    errors = capfd.readouterr().err
    assert len(errors.strip().splitlines()) == 1
    return errors


def runs(process, node):
    """Whether a process that live has started is a node."""
    try:
        return Path(f'/proc/{process.pid}/fd/1').readlink().name == f'{node}.log'
    except OSError:
        return False


def nodes_of(pid):
    """The processes of a live scan's nodes, which are forked from another child of it."""
    try:
        forks = [fork for child in psutil.Process(pid).children() for fork in child.children()]
    except psutil.Error:
        return []
    return [p for p in forks if any(runs(p, name) for name in NODES)]


class LiveRun:
    """A live scan into a folder; its output is read as it comes."""

    def __init__(self, out, *arguments, prefix=(), cwd=None, **variables):
        self.out = out
        self.process = subprocess.Popen(
            [*prefix, *command('live', '--out', out, *arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env=environment() | variables,
        )
        self.errors, self.text = '', ''
        self._readers = [
            threading.Thread(target=self._read, args=(name,), daemon=True) for name in ('errors', 'text')
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, name):
        for line in self.process.stderr if name == 'errors' else self.process.stdout:
            setattr(self, name, getattr(self, name) + line)

    def until(self, condition, what, deadline_s=90):
        end = time.monotonic() + deadline_s
        while not (value := condition()):
            assert self.process.poll() is None, f'live ended before {what}: {self.errors}'
            assert time.monotonic() < end, f'{what} did not come: {self.errors}'
            time.sleep(0.02)
        return value

    def until_said(self, text, deadline_s=90):
        self.until(lambda: text in self.errors, text, deadline_s)

    def node(self, name):
        """The process of a node."""

        def found():
            return next((node for node in nodes_of(self.process.pid) if runs(node, name)), None)

        return self.until(found, name)

    def kill(self, name):
        """kill -9."""
        victim = self.node(name)
        victim.kill()
        self.until(lambda: not runs(victim, name) or victim.status() == 'zombie', f'the end of {name}')

    def interrupt(self):
        self.process.send_signal(signal.SIGINT)

    def end(self, timeout=150):
        """The exit code."""
        code = self.process.wait(timeout)
        for reader in self._readers:
            reader.join(10)
        assert 'Traceback' not in self.errors
        return code

    @property
    def summary(self):
        return summary_of(self.out)

    @property
    def metrics(self):
        return json.loads((self.out / 'metrics.json').read_text())


def holds_the_bounds(metrics):
    """The bounds of a good model, whatever was done to the nodes."""
    assert metrics['verdict'] == 'right'
    assert metrics['attitude_deg']['median'] <= 0.3
    assert metrics['attitude_deg']['max'] <= 1.0
    assert metrics['model_mm']['rmse'] <= 1.0
    assert metrics['closures']['false'] == 0
