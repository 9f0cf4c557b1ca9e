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

"""``debris-scan doctor``: checks what a scan needs, and what to do about each failure.

Each check yields findings: Python, numpy and the other libraries, ROS and its middleware, shared memory, a
round trip over DDS, the disk, and the camera drivers. Libraries are imported in a process of their own,
because a broken one may crash it.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from debris_scanner.cli.errors import BAD_INPUT, DONE, ROS_REMEDY
from debris_scanner.cli.live.progress_line import in_colour
from debris_scanner.drivers.faults import DriverError
from debris_scanner.drivers.library_check import DRIVERS, check_library
from debris_scanner.nodes.lifecycle.middleware import (
    MB,
    PROFILE_VARIABLE,
    SHARED_MEMORY,
    choose_profile,
    leaked_segments,
    refuse_full,
)

OK, WARN, FAIL, SKIP = 'OK', 'WARN', 'FAIL', 'SKIP'
GB = 1 << 30

ROS = (
    'import sensor_msgs.msg, nav_msgs.msg, visualization_msgs.msg, diagnostic_msgs.msg, std_srvs.srv, rclpy; '
    'print(rclpy.get_rmw_implementation_identifier())'
)
LIBRARIES = {
    'numpy': 'import numpy',
    'scipy': 'import scipy.spatial',
    'networkx': 'import networkx',
    'open3d': 'from debris_scanner.core.open3d_library import load_open3d; load_open3d()',
    # compiled code with its cache on disk
    'numba': 'from debris_scanner.core.geometry import exp_so3; from numpy import zeros; exp_so3(zeros(3))',
    'rosbags': 'from rosbags.typesys import Stores, get_typestore; get_typestore(Stores.ROS2_JAZZY)',
    'scikit-image': 'import skimage.measure',
}


@dataclass(frozen=True)
class Finding:
    """One line of the report; ``advice`` says what to do if something is wrong."""

    status: str
    subject: str
    text: str
    advice: str = ''


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument(
        '--clean', action='store_true', help='remove shared memory that killed processes left behind'
    )
    parser.add_argument(
        '--warm', action='store_true', help='compile now what the first scan would compile, a minute or two'
    )


def run(args: argparse.Namespace) -> int:
    """Print a line for each finding, then the verdict; exit code 2 if a check failed."""
    found = []
    for check in CHECKS:
        for finding in check():
            found.append(finding)
            line = f'{finding.status:4}  {finding.subject}: {finding.text}'
            print(in_colour(line, sys.stdout), flush=True)
            if finding.advice:
                print(f'      -> {finding.advice}', flush=True)
    if args.clean:
        _clean()
    print(verdict_of(found))
    if args.warm:
        _warm()
    return BAD_INPUT if any(f.status == FAIL for f in found) else DONE


def verdict_of(found: Sequence[Finding]) -> str:
    """All findings in one line."""
    by_status = {status: [f.subject for f in found if f.status == status] for status in (FAIL, WARN, SKIP)}
    skipped = f'; skipped, as optional: {", ".join(by_status[SKIP])}' if by_status[SKIP] else ''
    if by_status[FAIL]:
        return f'Verdict: not ready: mend {", ".join(dict.fromkeys(by_status[FAIL]))}{skipped}'
    if by_status[WARN]:
        return f'Verdict: ready, with a warning about {", ".join(dict.fromkeys(by_status[WARN]))}{skipped}'
    return f'Verdict: ready{skipped}'


def _warm() -> None:
    from debris_scanner.warm_up import warm_up

    print('compiling the kernels', flush=True)
    start = time.monotonic()
    warm_up()
    print(
        f'{OK:4}  kernels: ready after {time.monotonic() - start:.1f} s; the next start takes a second or two'
    )


def ask_python(code: str, timeout_s: float = 60) -> tuple[str | None, str]:
    """Last line that ``code`` prints in a new interpreter, or None and why it failed."""
    try:
        done = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None, f'no answer within {timeout_s:.0f} s'
    if done.returncode:
        lines = [re.sub(r'\s+', ' ', line) for line in done.stderr.splitlines() if line.strip()]
        return None, lines[-1][:200] if lines else f'ended with code {done.returncode}'
    return (done.stdout.strip().splitlines() or [''])[-1], ''


def version_of(distribution: str) -> str | None:
    """Version of an installed distribution."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def check_python() -> Iterator[Finding]:
    """The interpreter, and whether the ROS wheels' start-up hook ran for it."""
    version = '.'.join(map(str, sys.version_info[:3]))
    if (3, 11) <= sys.version_info[:2] <= (3, 12):
        yield Finding(OK, 'python', f'{version} in {sys.prefix}')
    else:
        yield Finding(
            WARN, 'python', version, 'ROS 2 Jazzy is built for Python 3.12, its wheels also for 3.11'
        )
    library_path = os.environ.get('LD_LIBRARY_PATH', '').split(os.pathsep)
    if os.environ.get('_ROS_WHEELS_BOOTSTRAP_COMPLETE') and not any(
        path and Path(path).is_relative_to(sys.prefix) for path in library_path
    ):
        yield Finding(
            FAIL,
            'environment',
            'inherited from a ROS program of another Python environment',
            'unset _ROS_WHEELS_BOOTSTRAP_COMPLETE, then start again',
        )


def check_numpy() -> Iterator[Finding]:
    """The imported numpy is the installed one: another copy in the path breaks compiled libraries."""
    answer, error = ask_python('import numpy; print(numpy.__version__, numpy.__file__)')
    installed = version_of('numpy')
    again = f'{sys.executable} -m pip install --force-reinstall numpy=={installed}'
    if answer is None:
        yield Finding(FAIL, 'numpy', error, f'{again}; is another one in PYTHONPATH?' if installed else again)
    elif installed and answer.split()[0] != installed:
        found, where = answer.split(maxsplit=1)
        text = f'{found} of {where} is imported instead of the installed {installed}'
        yield Finding(FAIL, 'numpy', text, 'unset PYTHONPATH, or remove the other copy')


def check_libraries() -> Iterator[Finding]:
    """Each library imported in a process of its own, because a conflict of two may crash it."""
    for name, code in LIBRARIES.items():
        answer, error = ask_python(code)
        if answer is None:
            yield Finding(
                FAIL, name, error, f'reinstall it: {sys.executable} -m pip install --force-reinstall {name}'
            )
        else:
            yield Finding(OK, name, version_of(name) or version_of(f'{name}-cpu') or 'installed')
    if version_of('open3d') and version_of('open3d-cpu'):
        yield Finding(
            WARN, 'open3d', 'open3d and open3d-cpu overwrite each other', 'pip uninstall one of them'
        )
    _, error = ask_python(
        'from debris_scanner.core.open3d_library import load_open3d; import numba; load_open3d()'
    )
    if error:
        yield Finding(
            FAIL, 'numpy, numba and open3d', error, 'install the versions that constraints.txt names'
        )


def check_ros() -> Iterator[Finding]:
    """Rclpy, its middleware and the messages, and whether ``ros2 run`` finds the package."""
    answer, error = ask_python(ROS)
    if answer is None:
        yield Finding(FAIL, 'ros', error, _remedy(error))
        yield from _check_prefixes()
        return
    yield Finding(OK, 'ros', f'rclpy {version_of("rclpy") or ""} on {answer}'.replace('  ', ' '))
    if 'fastrtps' not in answer:
        yield Finding(
            WARN,
            'middleware',
            f'{answer} does not read our Fast DDS profile',
            'configure it for messages of 5 MB',
        )
    yield from _check_prefixes()


def check_shared_memory() -> Iterator[Finding]:
    """The middleware's profile, and free shared memory for its segments."""
    own = os.environ.get(PROFILE_VARIABLE)
    if own and not Path(own).is_file():
        yield Finding(FAIL, PROFILE_VARIABLE, f'{own} does not exist', f'unset {PROFILE_VARIABLE}')
    elif own:
        yield Finding(OK, PROFILE_VARIABLE, f'your own: {own}')
    _, remark = choose_profile()
    status = WARN
    try:
        refuse_full()
    except OSError as error:
        status, remark = FAIL, str(error)
    if remark:
        yield Finding(
            status,
            'shared memory',
            remark,
            'provide 512 MB (docker run --shm-size=512m), or use depth images instead of clouds',
        )
    else:
        usage = shutil.disk_usage(SHARED_MEMORY)
        yield Finding(OK, 'shared memory', f'{usage.free // MB} of {usage.total // MB} MB free')
    if leaked := leaked_segments():
        size = sum(path.stat().st_size for path in leaked) / MB
        yield Finding(
            WARN,
            'shared memory',
            f'{len(leaked)} segments left by killed processes, {size:.0f} MB',
            'debris-scan doctor --clean',
        )


def check_round_trip() -> Iterator[Finding]:
    """A megabyte sent to another process and back over the middleware."""
    answer, error = ask_python('from debris_scanner.cli.dds_probe import ping; print(ping())', timeout_s=30)
    if answer is None:
        yield Finding(
            FAIL,
            'DDS round trip',
            error,
            'a firewall or VPN may block discovery: try ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST',
        )
    else:
        yield Finding(OK, 'DDS round trip', answer)


def check_disk() -> Iterator[Finding]:
    """Free space for results in the current folder."""
    free = shutil.disk_usage(Path.cwd()).free
    status = FAIL if free < 100 * MB else WARN if free < GB else OK
    yield Finding(
        status,
        'disk',
        f'{free / GB:.1f} GB free here',
        '' if status == OK else 'free some space, or choose another --out',
    )


def check_drivers() -> Iterator[Finding]:
    """Libraries of the camera drivers; only ``live --driver`` needs them."""
    for driver in DRIVERS:
        try:
            yield Finding(OK, f'driver {driver}', check_library(driver))
        except DriverError as error:
            text = f'not usable, needed only by live --driver {driver}: {error.text}'
            yield Finding(SKIP, f'driver {driver}', text, error.advice)


CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    check_python,
    check_numpy,
    check_libraries,
    check_ros,
    check_shared_memory,
    check_round_trip,
    check_disk,
    check_drivers,
)


def _check_prefixes() -> Iterator[Finding]:
    """``ros2 run`` and ``ros2 launch`` find packages by AMENT_PREFIX_PATH."""
    name = 'AMENT_PREFIX_PATH'
    nodes = Path(sys.prefix) / 'lib' / 'debris_scanner'
    prefixes = [p for p in os.environ.get(name, '').split(os.pathsep) if p]
    if missing := [p for p in prefixes if not Path(p).is_dir()]:
        advice = f'open a new shell, or unset {name}; then source the setup file of your workspace'
        yield Finding(WARN, name, f'names folders that do not exist: {", ".join(missing)}', advice)
    if any((Path(p) / 'lib' / 'debris_scanner').is_dir() for p in prefixes):
        yield Finding(OK, name, 'names where debris_scanner is installed')
    elif prefixes:
        advice = 'for ros2 run, source the setup file of its workspace'
        if nodes.is_dir():
            advice = f'for ros2 run: export {name}={sys.prefix}:${name}'
        yield Finding(WARN, name, 'does not name a prefix with debris_scanner', advice)
    elif shutil.which('ros2') is None:
        yield Finding(SKIP, 'ros2', f'not installed; start the nodes with debris-scan live, or from {nodes}')
    else:
        yield Finding(OK, name, f'not set; for ros2 run under pip: export {name}={sys.prefix}')


def _remedy(error: str) -> str:
    middleware = os.environ.get('RMW_IMPLEMENTATION')
    if middleware and ('rmw' in error.lower() or 'middleware' in error.lower()):
        return f'unset RMW_IMPLEMENTATION, or install {middleware.replace("_", "-")} where rclpy comes from'
    return ROS_REMEDY


def _clean() -> None:
    leaked = leaked_segments()
    for path in leaked:
        path.unlink(missing_ok=True)
    print(f'removed {len(leaked)} leaked shared-memory segments')
