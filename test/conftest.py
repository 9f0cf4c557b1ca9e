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

"""Fixtures that every test folder shares."""

import fcntl
import math
import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from debris_scanner.kernel_cache import prepare_process

prepare_process()  # before any test imports numpy

# The same examples each time; how long one takes says nothing beside other tests.
settings.register_profile('suite', deadline=None, derandomize=True)
settings.load_profile('suite')

TURN_FRAMES = 150  # of the recorded session: 126 are a turn

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # `make test &`: our children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Workers take whole modules (--dist loadscope): first those with slow tests and, by turns, with nodes.

    Shared out test by test, a module's fixtures are made again in each worker: many cost as much as a scan.
    Nodes wait more than they compute: where all workers have some, the processor is idle.
    """
    if hasattr(config, 'workerinput'):
        slow = Counter(item.path for item in items if item.get_closest_marker('slow') is not None)
        waiting = dict.fromkeys(item.path for item in items if item.get_closest_marker('ros') is not None)
        computing = sorted(slow.keys() - waiting.keys(), key=lambda path: (-slow[path], path))
        turns = (path for pair in zip_longest(computing, waiting) for path in pair)
        order = {path: k for k, path in enumerate(turns)}
        items.sort(key=lambda item: order.get(item.path, len(order)))


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Folder of recorded data that is not part of this repository; skips the test where it is absent."""
    default = Path(__file__).resolve().parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('DEBRIS_SCANNER_DATA', default))
    if not folder.is_dir():
        pytest.skip(f'no recorded data at {folder}; set DEBRIS_SCANNER_DATA')
    return folder


@pytest.fixture(scope='session')
def golden() -> Path:
    """Folder of values computed by PCL 1.13 (cases.npz, refine.npz, ...); skips where it is absent."""
    default = Path(__file__).resolve().parents[2] / 'shared' / 'reference' / 'pcl-golden'
    folder = Path(os.environ.get('DEBRIS_SCANNER_GOLDEN', default))
    if not folder.is_dir():
        pytest.skip(f'no PCL values at {folder}; set DEBRIS_SCANNER_GOLDEN')
    return folder


@pytest.fixture(scope='module')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless browser; skips where there is none."""
    from browser import Browser, find_chromium

    path = find_chromium()
    if path is None:
        pytest.skip('no Chromium here; on Debian: apt-get install chromium')
    profile = tmp_path_factory.mktemp('browser') / 'profile'
    browser = Browser(path, profile)
    yield browser
    browser.close()
    shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture(scope='session')
def session_bag() -> Path:
    """The recorded session of this repository: a spinning shuttle stack, two turns, with its truth."""
    return Path(__file__).resolve().parents[1] / 'bags' / 'shuttle_stack_spin'


@pytest.fixture(scope='session')
def turn_bag(session_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 150 frames of the recorded session, with their truth: the loop closes at the 126th."""

    def cut(folder: Path) -> None:
        from rosbags.rosbag2 import Reader

        from msg_adapters.bag_writer import BagWriter

        written: Counter[str] = Counter()
        with Reader(session_bag) as recorded, BagWriter(folder, compress=True) as bag:
            for connection, stamp_ns, data in recorded.messages():
                written[connection.topic] += 1
                if written[connection.topic] <= TURN_FRAMES:
                    bag.write_raw(connection.topic, connection.msgtype, stamp_ns, bytes(data))
            lines = (session_bag / 'truth.tum').read_text().splitlines(keepends=True)
            (bag.folder / 'truth.tum').write_text(''.join(lines[:TURN_FRAMES]))
            shutil.copy(session_bag / 'truth_mesh.ply', bag.folder)

    return _once(tmp_path_factory, 'turn', cut)


@pytest.fixture(scope='session')
def brief_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A turn of the same target in 45 frames, from twice as far: a scan of it costs a third.

    For tests that need a scan with a model, whatever its accuracy; the loop closes with the 38th frame.
    """
    from debris_scanner.cli.main import main

    def simulated(folder: Path) -> None:
        options = ['--range', '1.6', '--spin', '1.0', '--rate', '6', '--seconds', '7.5']
        assert main(['simulate', 'shuttle_stack', '--out', str(folder), *options]) == 0

    return _once(tmp_path_factory, 'brief', simulated)


@pytest.fixture(scope='session')
def two_turns_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two turns of the same target at 10 Hz, from twice as far, in 12 s; played again, it turns on.

    For live scans that go on after the loop has closed, with the 60th frame of 120.
    """
    from debris_scanner.cli.main import main

    def simulated(folder: Path) -> None:
        options = ['--range', '1.6', '--spin', str(2 * math.pi / 6), '--seconds', '12']
        assert main(['simulate', 'shuttle_stack', '--out', str(folder), *options]) == 0

    return _once(tmp_path_factory, 'two_turns', simulated)


@pytest.fixture
def full_turn() -> Any:
    """Arrays of 36 earlier key frames as a closure search takes them; see candidate_turns."""
    import candidate_turns

    return candidate_turns.full_turn()


@dataclass(frozen=True)
class Recording:
    """The recorded session: depth frames, true T_sensor_target by stamp, targets and their views."""

    frames: Sequence[Any]
    truth: dict[int, Any]
    targets: Sequence[Any]  # preprocessed
    views: Sequence[Any]

    def pose(self, k: int) -> Any:
        """True T_target_sensor (4, 4) of frame k."""
        from debris_scanner.core.geometry import inverse

        return inverse(self.truth[self.frames[k].stamp_ns])


@pytest.fixture(scope='session')
def recorded_frames(session_bag: Path) -> list[Any]:
    """Depth frames of one turn and a little more of the recorded session."""
    from msg_adapters.bags import open_session

    with open_session(session_bag) as session:
        return [frame for _, (_, frame) in zip(range(140), session, strict=False)]


@pytest.fixture(scope='session')
def recording(session_bag: Path, recorded_frames: list[Any]) -> Recording:
    """One turn and a little more of the recorded session, preprocessed once; tests only read it."""
    return _preprocessed(session_bag, recorded_frames)


@pytest.fixture(scope='session')
def coarse_recording(session_bag: Path, recorded_frames: list[Any]) -> Recording:
    """The same with a quarter of the pixels: what is done with it costs a third.

    For tests of what happens and when. A module has a fixture ``recording`` of its own that returns it.
    """
    from coarse_frames import coarse
    from on_demand import OnDemand

    frames = OnDemand(len(recorded_frames), lambda k: coarse(recorded_frames[k]))
    return _preprocessed(session_bag, frames)


def _preprocessed(session_bag: Path, frames: Sequence[Any]) -> Recording:
    from on_demand import OnDemand

    from debris_scanner.io.trajectories import read_tum
    from debris_scanner.sensing.preprocessing import Preprocessor
    from debris_scanner.sensing.views import View
    from debris_scanner.settings import Settings

    preprocessor = Preprocessor(Settings().isolation, Settings().normals)

    def target(k: int) -> Any:
        for earlier in range(k):  # it remembers them
            targets[earlier]
        return preprocessor.process(frames[k])

    targets = OnDemand(len(frames), target)
    truth = {p.stamp_ns: p.T_sensor_target for p in read_tum(session_bag / 'truth.tum')}
    return Recording(frames, truth, targets, OnDemand(len(frames), lambda k: View(targets[k])))


@pytest.fixture(scope='session')
def true_model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Model fused from the recording's frames at their true poses, in the true target frame."""

    def made(folder: Path) -> None:
        import numpy as np

        from debris_scanner.modelling.fusion import FusionSettings
        from debris_scanner.modelling.refinement import fuse, make_model

        recording: Recording = request.getfixturevalue('recording')
        posed = [(recording.targets[k], recording.pose(k)) for k in range(0, 126, 3)]
        surface = fuse(posed, FusionSettings())
        folder.mkdir()
        (folder / 'model').write_bytes(pickle.dumps(make_model(surface, [], np.zeros(3))[0]))

    return pickle.loads((_once(tmp_path_factory, 'true_model', made) / 'model').read_bytes())


def _once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that one worker of a run makes, while the others wait for it; not to be changed, copy it.

    ``make test`` names the folder of all of them, which both of its runs share.
    """
    shared = factory.getbasetemp()
    if 'PYTEST_XDIST_WORKER' in os.environ:
        shared = shared.parent
    folder = Path(os.environ.get('DEBRIS_SCANNER_ONCE', shared / 'once')) / name
    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix('.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            make(folder)
    return folder


def _scan(bag: Path, out: Path) -> None:
    """Scan in a process of its own, from the command line."""
    command = [sys.executable, '-m', 'debris_scanner', 'scan', str(bag), '--out', str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    out.with_suffix('.stdout').write_text(done.stdout)
    out.with_suffix('.stderr').write_text(done.stderr)


@pytest.fixture(scope='session')
def session_result(session_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What an offline scan of the recorded session wrote; beside it what it printed (.stdout, .stderr)."""

    return _once(tmp_path_factory, 'shuttle', lambda out: _scan(session_bag, out))


@pytest.fixture(scope='session')
def brief_result(brief_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What an offline scan of the brief recording wrote."""
    return _once(tmp_path_factory, 'brief_scan', lambda out: _scan(brief_bag, out))


@pytest.fixture(scope='session')
def bunny_bag(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real bunny, imported into a bag."""
    from debris_scanner.cli.main import main

    source = shared_data / 'bunny_primesense'
    if not source.is_dir():
        pytest.skip('no bunny_primesense among the recorded data')

    def imported(out: Path) -> None:
        assert main(['import', str(source), '--out', str(out)]) == 0

    return _once(tmp_path_factory, 'bunny', imported)
