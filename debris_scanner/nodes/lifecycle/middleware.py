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

"""Configures the middleware before ``rclpy.init()``, so that large clouds arrive.

With its defaults, Fast DDS loses nine of ten best-effort clouds of 4.9 MB at 30 Hz between two processes.
With a shared-memory segment that holds several clouds it loses none. A node that was killed is back in half a
second, but its neighbours find it at their next announcement: every 0.5 s in our profiles, 3 s by default.
What is lost on a reliable topic is sent again at the next heartbeat: every 0.2 s, and 3 s by default, which
is longer than who joins the messages of a frame waits.
:func:`prepare` chooses a profile that fits this machine; :func:`leaked_segments` finds shared memory that
killed processes left behind.
"""

import ctypes
import fcntl
import os
import platform
import shutil
import sys
from pathlib import Path

FAST_DDS = 'rmw_fastrtps_cpp'
MB = 1 << 20
SHARED_MEMORY = Path('/dev/shm')
PROFILE_VARIABLE = (
    'FASTRTPS_DEFAULT_PROFILES_FILE'  # this version of Fast DDS ignores the newer FASTDDS_ name
)

# Every participant allocates its whole segment when it starts. A scan with a simulator and a viewer has seven
# of them. Container runtimes provide 64 MB. Only who sends images needs a large one.
ROOMY_BYTES = 512 * MB
LARGE_SEGMENT_BYTES = 64 * MB
STAGE_SEGMENT_BYTES = 16 * MB
SMALL_SEGMENT_BYTES = 6 * MB
SMALL_STAGE_SEGMENT_BYTES = 1 * MB
TRACING_BYTES = 64 << 10  # ROS's tracing library makes two pages there when it is loaded
SEGMENT_OVERHEAD_BYTES = 1 * MB  # a participant's second segment of 0.5 MB, and its ports

_HERE = Path(__file__).resolve().parent
_ROOMY, _SMALL, _UDP = 'fastdds_profile', 'fastdds_profile_small', 'fastdds_profile_udp'
_STAGE = '_stage'
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3


def prepare(*, local_only: bool = False, images: bool = True) -> list[str]:
    """Configure this process and its children for large messages; call it before ``rclpy.init()``.

    Variables that the user has set stay. ``RMW_IMPLEMENTATION`` is never changed.

    Args:
        local_only: stay on this host: other hosts neither see nor reach this process.
        images: whether this process sends images or a sensor's clouds.

    Returns:
        Remarks for the user, to be logged once the node exists.
    """
    remarks: list[str] = []
    if local_only and not os.environ.get('ROS_LOCALHOST_ONLY'):
        os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    other = os.environ.get('RMW_IMPLEMENTATION') or FAST_DDS
    if other != FAST_DDS:
        remarks.append(f'the middleware is {other}: clouds travel by its own settings, see docs/install.md')
    elif not (chosen := os.environ.get(PROFILE_VARIABLE, '')) or Path(chosen).parent == _HERE:
        # who started this process chose for itself, and memory may have been filled since
        profile, remark = choose_profile(images=images)
        if remark and profile.stem.removesuffix(_STAGE) not in chosen:
            remarks.append(remark)
        if _is_local_only():
            profile = profile.with_stem(f'{profile.stem}_local')
        os.environ[PROFILE_VARIABLE] = str(profile)
    if not os.environ.get('AMENT_PREFIX_PATH') and (Path(sys.prefix) / 'share' / 'ament_index').is_dir():
        os.environ['AMENT_PREFIX_PATH'] = sys.prefix  # installed by pip, so no setup file was sourced
    keep_large_buffers()
    return remarks


def profile_of_drivers() -> Path:
    """The Fast DDS profile for who publishes images, so that the shared memory holds several of them."""
    return _HERE / f'{_ROOMY}.xml'


def choose_profile(folder: Path = SHARED_MEMORY, *, images: bool = True) -> tuple[Path, str]:
    """The Fast DDS profile that fits this machine's shared memory, and a remark unless it is the best one.

    Args:
        folder: where shared memory lies.
        images: whether this process sends images.
    """
    try:
        usage = shutil.disk_usage(folder)
    except OSError:
        return _HERE / f'{_UDP}.xml', f'no shared memory at {folder}: clouds travel by UDP'
    free = f'{folder} has {usage.free // MB} of {usage.total // MB} MB free'
    room = usage.free - SEGMENT_OVERHEAD_BYTES
    roomy, small, kind = LARGE_SEGMENT_BYTES, SMALL_SEGMENT_BYTES, ''
    if not images:
        roomy, small, kind = STAGE_SEGMENT_BYTES, SMALL_STAGE_SEGMENT_BYTES, _STAGE
    if usage.total >= ROOMY_BYTES and room >= roomy:
        return _HERE / f'{_ROOMY}{kind}.xml', ''
    if room >= small:
        return _HERE / f'{_SMALL}{kind}.xml', f'{free}: using small shared-memory segments'
    return _HERE / f'{_UDP}.xml', f'{free}: clouds travel by UDP'


def refuse_full(folder: Path = SHARED_MEMORY) -> None:
    """Refuse shared memory that is full: loading ROS would end this process by SIGBUS, without a word.

    Raises:
        OSError: there is none left.
    """
    if folder.is_dir() and shutil.disk_usage(folder).free < TRACING_BYTES:
        raise OSError(f'shared memory is full, so ROS cannot be loaded: delete files in {folder}')


def keep_large_buffers() -> bool:
    """Make malloc reuse cloud-sized buffers instead of mapping new pages for each; False without glibc."""
    if platform.libc_ver()[0] != 'glibc':
        return False
    libc = ctypes.CDLL(None)
    return bool(libc.mallopt(_M_MMAP_THRESHOLD, 32 * MB) and libc.mallopt(_M_TRIM_THRESHOLD, 1 << 30))


def leaked_segments(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Files of Fast DDS segments and ports that no running process uses.

    Fast DDS locks ``<name>_el`` while it uses the segment, and the kernel releases the lock with the process,
    so the segment is unused if the lock can be acquired.
    """
    leaked: list[Path] = []
    for lock in sorted(folder.glob('fastrtps_*_el')):
        if not _abandoned(lock):
            continue
        name = lock.name.removesuffix('_el')
        family = (lock, folder / name, folder / f'sem.{name}_mutex')
        leaked += [path for path in family if path.exists()]
    return leaked


def _is_local_only() -> bool:
    """Whether the user restricted ROS to this host.

    LOCALHOST alone announces this process to no other host, but a peer that knows its address can still
    connect. The local profiles listen on the loopback interface only.
    """
    only = os.environ.get('ROS_LOCALHOST_ONLY') == '1'
    return only or os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '').upper() == 'LOCALHOST'


def _abandoned(lock: Path) -> bool:
    try:
        with lock.open('rb') as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
    except OSError:  # locked, owned by another user, or deleted meanwhile
        return False
