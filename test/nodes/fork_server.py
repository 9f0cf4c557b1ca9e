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

"""A process that has loaded what all nodes load, and forks for each of them.

A node loads numba, SciPy, kernels and messages for three seconds of processor time. Loaded once, as by the
process on standby of a live scan, they leave it its own modules, rclpy, whose threads a fork would lack, and
what it does. Tests of live scans, launch files and executables start theirs the long way.
"""

import gc
import importlib
import json
import os
import sys
from pathlib import Path

MESSAGES = ('diagnostic_msgs', 'lifecycle_msgs', 'nav_msgs', 'rcl_interfaces', 'sensor_msgs')


def become(node, arguments, log, folder, environment):
    """Run a node in this process, with output and surroundings of its own; its exit code."""
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    with Path(log).open('ab') as output, Path(os.devnull).open('rb') as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    paths = environment.get('PYTHONPATH', '').split(os.pathsep)
    sys.path[:0] = [path for path in paths if path and path not in sys.path]
    sys.argv = [node]
    return importlib.import_module(f'debris_scanner.nodes.{node}').main(arguments)


def main():
    """Fork for each line on stdin, and say the process's id on stdout; end with stdin."""
    from debris_scanner.warm_up import warm_up

    warm_up()
    for name in MESSAGES:
        importlib.import_module(f'{name}.msg')
    for name in ('bags', 'models', 'target_frames'):
        importlib.import_module(f'msg_adapters.{name}')
    assert len(list(Path('/proc/self/task').iterdir())) == 1, 'only what has one thread may be forked'
    gc.freeze()  # what is loaded stays in memory that all share
    for line in sys.stdin:
        answer, told = os.pipe()
        between = os.fork()
        if not between:
            child = os.fork()
            if not child:
                os.close(answer)
                os.close(told)
                return become(*json.loads(line))
            os.write(told, f'{child}\n'.encode())
            os._exit(0)
        os.waitpid(between, 0)  # since then the node is a child of the test
        os.close(told)
        with os.fdopen(answer) as number:
            print(number.read(), end='', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
