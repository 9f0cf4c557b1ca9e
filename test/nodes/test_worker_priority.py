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

"""A worker that steps back leaves the rest of its process as it is."""

import os
import sys
import threading

import pytest

from debris_scanner.nodes.lifecycle.worker import Worker


@pytest.mark.skipif(sys.platform != 'linux', reason='threads of other systems have no niceness of their own')
def test_only_the_worker_is_nice():
    before = os.getpriority(os.PRIO_PROCESS, 0)
    if before > 14:
        pytest.skip('too nice already to become nicer')
    found = []
    worker = Worker(lambda: None, nice=before + 5)
    worker.post(lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    worker.start()
    worker.stop()
    worker.check()
    assert found == [before + 5]
    assert os.getpriority(os.PRIO_PROCESS, 0) == before
