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

"""The real `ros2` command, launch, tf2_ros and colcon, where they are installed into this environment."""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ENVIRONMENT = Path(sys.prefix) / 'ros2-env'  # sourced for each command


def need_ros2():
    """Skip the test where there is no ROS beside the wheels."""
    if not ENVIRONMENT.is_file():
        pytest.skip('no ros2 command in this environment')


class Command:
    """A command that runs while a test asks others; leaving the context interrupts it, as Ctrl-C does."""

    def __init__(self, folder, *command):
        need_ros2()
        folder.mkdir(parents=True, exist_ok=True)
        self._log = folder / f'{time.monotonic_ns()}.log'
        line = f'. {shlex.quote(str(ENVIRONMENT))}; exec {shlex.join(map(str, command))}'
        environment = {k: v for k, v in os.environ.items() if k != 'AMENT_PREFIX_PATH'}
        environment |= {'PYTHONUNBUFFERED': '1', 'ROS_LOG_DIR': str(folder / 'ros_log')}
        with self._log.open('wb') as output:
            self.process = subprocess.Popen(
                ['bash', '-c', line],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def text(self):
        """The output so far."""
        return self._log.read_text(errors='replace')

    def until(self, words, timeout_s=180.0, times=1):
        """Wait until the output has the words, so many times."""
        end = time.monotonic() + timeout_s
        while self.text.count(words) < times:
            assert self.process.poll() is None, f'ended with {self.process.returncode}:\n{self.text}'
            assert time.monotonic() < end, f'{words!r} did not come:\n{self.text}'
            time.sleep(0.1)

    def wait(self, timeout_s=240.0):
        """The exit code."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f'still runs:\n{self.text}') from None

    def interrupt(self):
        """Ctrl-C: SIGINT to all processes of the terminal."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.interrupt()
        try:
            self.process.wait(120.0)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


def ran(folder, *command):
    """Exit code and output of a command that ends by itself."""
    with Command(folder, *command) as running:
        return running.wait(), running.text
