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


def test_a_middleware_that_hangs_at_the_end_does_not_keep_the_process():
    from debris_scanner.nodes.lifecycle.process import HUNG

    done = subprocess.run([sys.executable, '-c', HANGING], capture_output=True, text=True, timeout=60)
    assert done.returncode == HUNG == -signal.SIGALRM, done.stderr
    assert done.stdout == 'saved\n'
