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

"""``debris-scan live --driver``: simulated frames through the real libraries and nodes to a model."""

import signal
import subprocess
import time

import numpy as np
import pytest
from devices import build_stub, need_fakenect, need_library
from live_runs import command, environment, nodes_of, refused, run, runs, summary_of
from recordings import write_fakenect, write_oni

from debris_scanner.cli.evaluate import evaluate_and_print
from debris_scanner.core.frames import DepthFrame
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sim.depth_sensor import KINECT
from debris_scanner.sim.session import Simulation, SimulationSettings, write_truth

RATE_HZ = 5.0  # of the recording: slow enough for a machine that has more to do
GIVEN = [f'--camera={name}:={getattr(KINECT, name)}' for name in ('fx', 'fy', 'cx', 'cy')]


@pytest.fixture(scope='module')
def session():
    """A spinning target, one turn and most of a second one, in steps of a tenth of a radian."""
    settings = SimulationSettings(target='shuttle_stack', spin_rad_s=0.5, rate_hz=RATE_HZ, seconds=22.0)
    simulation = Simulation(settings)
    return simulation, list(simulation)


def judged(out, truth, session):
    """Metrics of a scan; a stamp's distance from the one before tells which frame it is of."""
    simulation, frames = session
    stamps = [pose.stamp_ns for pose in read_tum(out / 'target_pose.tum')]
    steps = np.diff(stamps) * 1e-9 * RATE_HZ  # the library plays by a clock of its own: 0.3 % slow was seen
    assert np.abs(steps - np.rint(steps)).max() < 0.3  # a frame may be late on a busy machine
    used = [frames[k] for k in np.cumsum([0, *np.rint(steps).astype(int)])]
    truth.mkdir()
    write_truth(truth, stamps, [f.T_sensor_target for f in used], simulation.target)
    seen = (
        DepthFrame(stamp, f.depth_mm * np.float32(0.001), f.camera)
        for stamp, f in zip(stamps, used, strict=True)
    )
    return evaluate_and_print(out, truth, seen)


@pytest.mark.ros
@pytest.mark.faults
@pytest.mark.slow
@pytest.mark.parametrize('driver', ['freenect', 'openni2'])
def test_recorded_camera_is_scanned_to_a_model(tmp_path, session, driver):
    depths = [frame.depth_mm for frame in session[1]]
    if driver == 'freenect':
        need_fakenect()
        device = write_fakenect(tmp_path / 'kinect', depths, RATE_HZ)
    else:
        need_library(driver)
        fov = (2 * np.arctan(320 / KINECT.fx), 2 * np.arctan(240 / KINECT.fy))
        device = write_oni(tmp_path / 'xtion.oni', depths, RATE_HZ, fov)
    out = tmp_path / 'out'
    done = run('live', '--driver', driver, '--device', device, *GIVEN, '--out', out)
    assert done.returncode == 0, done.stderr
    summary = summary_of(out)
    assert summary['result'] == 'model'
    assert summary['frames']['used'] >= 105  # 110, but for what an overloaded machine drops
    metrics = judged(out, tmp_path / 'truth', session)
    assert metrics['verdict'] == 'right'
    assert metrics['attitude_deg']['median'] <= 0.5
    assert metrics['model_mm']['rmse'] <= 1.5
    assert metrics['closures']['false'] == 0


def live_with_stub(folder, devices):
    """A live scan of the stub in place of libfreenect, which finds the devices 'none' or 'there'."""
    state = folder / 'state'
    state.write_text(devices)
    return subprocess.Popen(
        command(
            'live', '--driver', 'freenect', f'--camera=library:={build_stub(folder)}', '--out', folder / 'out'
        ),
        stderr=subprocess.PIPE,
        text=True,
        env=environment() | {'STUB_FREENECT': str(state)},
    )


@pytest.mark.ros
@pytest.mark.faults
@pytest.mark.slow
def test_without_a_device_live_says_so_and_ends_cleanly(tmp_path):
    live = live_with_stub(tmp_path, 'none')
    for line in live.stderr:
        if 'no Kinect v1 is plugged in' in line:
            break
    live.send_signal(signal.SIGINT)
    rest = live.stderr.read()
    assert live.wait(60) in (3, 130), rest
    assert 'Traceback' not in rest


@pytest.mark.ros
@pytest.mark.faults
@pytest.mark.slow
def test_a_driver_that_is_killed_comes_back(tmp_path):
    live, out = live_with_stub(tmp_path, 'there'), tmp_path / 'out'
    lines = iter(live.stderr)
    log = out / 'logs' / 'freenect_camera.log'

    def wait_for_device(times):
        deadline = time.monotonic() + 60
        while not log.exists() or log.read_text().count('Kinect: 640x480') < times:
            assert time.monotonic() < deadline
            time.sleep(0.1)

    wait_for_device(1)
    (driver,) = (p for p in nodes_of(live.pid) if runs(p, 'freenect_camera'))
    driver.kill()
    assert 'signal 9' in next(line for line in lines if 'freenect_camera ended' in line)
    wait_for_device(2)
    live.send_signal(signal.SIGINT)
    rest = live.stderr.read()
    assert live.wait(60) == 3, rest  # a wall that fills half of the image turns into no model
    assert 'Traceback' not in rest


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['--driver', 'freenect', '--camera', 'library:=/none.so'], 'apt-get install libfreenect0.5'),
        (['--driver', 'openni2', '--device', '{tmp}/none.oni'], 'does not exist'),
        (['--driver', 'openni2', '--camera', 'fx=5'], 'NAME:=VALUE'),
        (['--device', '0'], '--driver'),
        (['--camera', 'fx:=570'], '--driver'),
        (['--camera', 'kinect9'], 'must be one of realsense, orbbec, azure, openni2, kinect, oak, zed'),
        (['--driver', 'kinect9'], 'kinect9'),
        (['--driver', 'openni2', '--bag', 'a'], 'not allowed with'),
    ],
)
def test_bad_input_is_one_line_and_starts_no_node(tmp_path, capfd, arguments, said):
    given = [a.format(tmp=tmp_path) for a in arguments]
    assert said in refused(capfd, *given, '--out', str(tmp_path / 'out'))
    assert not (tmp_path / 'out' / 'logs').exists()
