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

"""How the process of a node ends, also where the middleware does not."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros

# a node that has finished at once, in a middleware that waits for ever while it ends
HANGING = """
import time
from debris_scanner.nodes.lifecycle import process
from debris_scanner.nodes.lifecycle.stage import StageNode

class Hanging(StageNode):
    finished = True

    def problem(self): return None
    def diagnostic_values(self): return {}
    def reset_stage(self): pass
    def close(self): print('saved', flush=True)

    def destroy_node(self):
        while True:
            time.sleep(0.01)

process.PARTING_S = 0.5
process.run(lambda: Hanging('hanging'))
"""
ENDING = (
    HANGING.replace('while True', 'while False')
    + 'import gc; print(gc.get_freeze_count(), len(gc.get_objects()))'
)


def test_a_middleware_that_hangs_at_the_end_does_not_keep_the_process():
    from debris_scanner.nodes.lifecycle.process import HUNG

    done = subprocess.run([sys.executable, '-c', HANGING], capture_output=True, text=True, timeout=60)
    assert done.returncode == HUNG == -signal.SIGALRM, done.stderr
    assert done.stdout == 'saved\n'


def test_python_does_not_look_through_all_objects_once_more_as_a_node_ends():
    """That took a player 3.6 s on a busy machine, and launch asks again after 5."""
    done = subprocess.run([sys.executable, '-c', ENDING], capture_output=True, text=True, timeout=60)
    saved, counts = done.stdout.splitlines()
    frozen, left = map(int, counts.split())
    assert (saved, done.returncode) == ('saved', 0), done.stderr
    assert frozen > 100 * left
