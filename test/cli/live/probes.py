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

"""Stands in for the nodes' modules: what is tested with it is the handling of processes."""

import multiprocessing
import sys
import time
from pathlib import Path


def run_probe(node, arguments):
    return PROBES[node](*arguments)


def _refuses():
    print('first')
    print('the reason', file=sys.stderr)
    return 2


def _saves():
    parent = multiprocessing.parent_process()
    print(parent.pid, Path('/proc/self/comm').read_text(), flush=True)
    try:
        while parent.is_alive():
            time.sleep(0.02)
        print('alone', flush=True)
    except KeyboardInterrupt:
        print('saved', flush=True)
    return 0


PROBES = {'refuses': _refuses, 'ends': lambda: 0, 'saves': _saves}
