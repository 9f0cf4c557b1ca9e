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

"""Processes end when they are told to, whatever state they are in."""

import multiprocessing
import os
import signal
import time

import pytest

from debris_scanner.research.reproduce import workers


@pytest.mark.parametrize('stopped', [False, True])
def test_a_worker_can_be_ended(stopped, monkeypatch):
    monkeypatch.setattr(workers, '_GRACE_S', 0.3)
    process = multiprocessing.get_context('spawn').Process(target=time.sleep, args=(60,), daemon=True)
    process.start()
    if stopped:
        os.kill(process.pid, signal.SIGSTOP)
    workers.end(process)
    assert not process.is_alive()
    # of two pending signals the kernel may deliver either
    assert process.exitcode in ((-signal.SIGKILL, -signal.SIGTERM) if stopped else (-signal.SIGTERM,))
