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

"""Nodes as processes that need not load anything; see ``fork_server``."""

import ctypes
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

from debris_scanner.cli.live.processes import Children
from debris_scanner.nodes.lifecycle.process import PARENT

SUBREAPER = 36  # of prctl: orphans become children of this process
SERVER = Path(__file__).with_name('fork_server.py')


class Loaded:
    """The process that nodes are forked from; started when the first of them is asked for."""

    def __init__(self):
        self._process = None

    def fork(self, node, arguments, log, environment):
        """A node, as a ``subprocess.Popen``."""
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, '-P', SERVER],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | {'PYTHONUNBUFFERED': '1'},
                start_new_session=True,
            )
        prctl = ctypes.CDLL(None).prctl
        prctl(SUBREAPER, 1)
        try:
            order = json.dumps([node, arguments, str(log), str(Path.cwd()), environment])
            self._process.stdin.write(f'{order}\n')
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        finally:
            prctl(SUBREAPER, 0)
        return Forked([node, *arguments], int(answer))

    def close(self):
        if self._process is not None:
            self._process.communicate()


class Forked(subprocess.Popen):
    """A child of this process that another one has forked."""

    def __init__(self, args, pid):
        self.args, self.pid, self.returncode = args, pid, None
        self.stdin = self.stdout = self.stderr = None
        self._waitpid_lock = threading.Lock()
        self._child_created, self._sigint_wait_secs = True, 0.25


class ForkedChildren(Children):
    """Children that are forked from the loaded process."""

    def __init__(self, logs, loaded):
        super().__init__(logs)
        self._loaded = loaded

    def _spawn(self, node, arguments, log):
        environment = os.environ | {PARENT: str(os.getpid()), 'PYTHONUNBUFFERED': '1'}
        return self._loaded.fork(node, arguments, log, environment)
