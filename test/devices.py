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

"""Devices run as the nodes run them, and what came of it."""

import shutil
import subprocess
import threading
from pathlib import Path

import pytest

from debris_scanner.drivers.captures import DeviceSettings
from debris_scanner.drivers.faults import DriverError
from debris_scanner.drivers.freenect_library import replay_candidates
from debris_scanner.drivers.library_check import check_library
from debris_scanner.drivers.supervisor import DeviceSupervisor, Listener, Patience

HERE = Path(__file__).resolve().parent / 'drivers'


def need_library(driver):
    """Skip where a driver's library is not installed."""
    try:
        check_library(driver)
    except DriverError as error:
        pytest.skip(str(error))


def need_fakenect():
    """Skip where libfreenect's replay is not installed."""
    if not Path(replay_candidates()[0]).is_file():
        pytest.skip(f'no {replay_candidates()[0]}: sudo apt-get install libfreenect0.5')


def build_stub(folder):
    """The stub of libfreenect, compiled; skips without a compiler."""
    compiler = shutil.which('cc')
    if compiler is None:
        pytest.skip('no C compiler: sudo apt-get install gcc')
    library = folder / 'libstub_freenect.so'
    subprocess.run([compiler, '-shared', '-fPIC', '-o', library, HERE / 'stub_freenect.c'], check=True)
    return library


class Watcher:
    """A supervised device, and all that it said."""

    def __init__(self, driver, patience=None, **settings):
        self.opened, self.captures, self.faults, self.pauses = [], [], [], []
        self.ended = threading.Event()
        self._news = threading.Condition()
        listener = Listener(
            lambda info: self._add(self.opened, info),
            lambda capture: self._add(self.captures, capture),
            self._on_fault,
            self._on_end,
        )
        self.supervisor = DeviceSupervisor(driver, DeviceSettings(**settings), listener, patience)

    def __enter__(self):
        self.supervisor.start()
        return self

    def __exit__(self, *_):
        self.supervisor.stop()
        self.supervisor.check()

    def until(self, condition, what, seconds=30.0):
        """Wait until a condition holds."""
        with self._news:
            assert self._news.wait_for(condition, seconds), f'{what} did not come: {self.faults}'

    def stream(self, name):
        return [c for c in self.captures if c.stream == name]

    def _add(self, where, what):
        with self._news:
            where.append(what)
            self._news.notify_all()

    def _on_fault(self, error, pause_s):
        self.pauses.append(pause_s)
        self._add(self.faults, error)

    def _on_end(self):
        with self._news:
            self.ended.set()
            self._news.notify_all()


HASTY = Patience(opening=5.0, answer=1.0, frames=1.0, retry=0.05, most_retry=0.2)
