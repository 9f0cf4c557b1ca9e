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

"""Memory of a peak returns to the system."""

import subprocess
import sys

import pytest

from debris_scanner.core import memory as heap

CODE = """
import numpy as np, psutil
from debris_scanner.core.memory import release_memory

def resident():
    return psutil.Process().memory_info().rss / 1e6

# small blocks under one that stays: what the library keeps, for only the end of its heap goes back by itself
blocks = [np.ones(6000) for _ in range(2000)]
last = np.ones(6000)
full = resident()
del blocks
kept = resident()
release_memory()
print(full - kept, kept - resident())
"""


@pytest.mark.skipif(sys.platform != 'linux', reason='glibc')
def test_freed_memory_leaves_the_process():
    done = subprocess.run([sys.executable, '-c', CODE], capture_output=True, text=True, check=True)
    by_itself, given_back = (float(text) for text in done.stdout.split())
    assert by_itself < 30
    assert given_back > 60


def test_now_and_then(monkeypatch):
    now_s, given = [100.0], []
    monkeypatch.setattr(heap.time, 'monotonic', lambda: now_s[0])
    monkeypatch.setattr(heap, 'release_memory', lambda: given.append(now_s[0]))
    keeping = heap.Housekeeping()
    for _ in range(60):
        now_s[0] += 0.25
        keeping.look()
    assert given == [105.0, 110.0, 115.0]
