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

"""doctor: a line a check, what to do about it, and the exit code."""

import fcntl
import os
import subprocess
import sys
from collections import namedtuple

import pytest

from debris_scanner.cli import doctor
from debris_scanner.cli.main import main
from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.nodes.lifecycle import middleware
from debris_scanner.nodes.lifecycle.middleware import PROFILE_VARIABLE, leaked_segments

CODES = {'OK': 0, 'WARN': 0, 'FAIL': 2, 'SKIP': 0}
VERDICTS = {
    'OK': 'Verdict: ready',
    'WARN': 'Verdict: ready, with a warning about thing',
    'FAIL': 'Verdict: not ready: mend thing',
    'SKIP': 'Verdict: ready; skipped, as optional: thing',
}


@pytest.mark.parametrize('status', sorted(CODES))
def test_exit_code_and_advice(monkeypatch, capsys, status):
    finding = doctor.Finding(status, 'thing', 'as it is', 'do this')
    good = doctor.Finding('OK', 'other', 'fine')
    monkeypatch.setattr(doctor, 'CHECKS', (lambda: iter([finding]), lambda: iter([good])))
    assert main(['doctor']) == CODES[status]
    lines = capsys.readouterr().out.splitlines()
    *findings, verdict = lines
    assert findings == [f'{status:4}  thing: as it is', '      -> do this', 'OK    other: fine']
    assert verdict == VERDICTS[status]


def test_libraries_of_this_environment_are_usable():
    findings = list(doctor.check_libraries())
    assert {f.subject for f in findings} >= set(doctor.LIBRARIES)
    assert [f for f in findings if f.status != 'OK'] == []


def test_library_that_cannot_be_imported_fails(monkeypatch):
    monkeypatch.setattr(doctor, 'LIBRARIES', {'lost': 'import no_such_library'})
    failed = [f for f in doctor.check_libraries() if f.status == 'FAIL']
    assert [f.subject for f in failed] == ['lost']
    assert 'no_such_library' in failed[0].text
    assert 'pip install' in failed[0].advice


def test_driver_libraries_are_told_of_but_not_needed(monkeypatch):
    def check(driver):
        if driver == 'openni2':
            raise DriverError(Fault.LIBRARY, 'it is not there', 'install it')
        return 'libfreenect'

    monkeypatch.setattr(doctor, 'check_library', check)
    missing, there = doctor.check_drivers()
    assert (missing.status, missing.advice) == ('SKIP', 'install it')
    assert 'it is not there' in missing.text
    assert (there.status, there.text) == ('OK', 'libfreenect')


def test_library_that_ends_the_process_fails(monkeypatch):
    monkeypatch.setattr(doctor, 'LIBRARIES', {'crashing': 'import os; os.abort()'})
    failed = [f for f in doctor.check_libraries() if f.status == 'FAIL']
    assert [f.subject for f in failed] == ['crashing']


@pytest.mark.ros
def test_ros_and_round_trip(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '61')
    findings = [*doctor.check_ros(), *doctor.check_round_trip()]
    assert [f for f in findings if f.status == 'FAIL'] == []
    assert any(f.subject == 'DDS round trip' and 'and back in' in f.text for f in findings)


def test_missing_profile_fails(monkeypatch, tmp_path):
    monkeypatch.setenv(PROFILE_VARIABLE, str(tmp_path / 'none.xml'))
    first = next(iter(doctor.check_shared_memory()))
    assert (first.status, first.subject) == ('FAIL', PROFILE_VARIABLE)


def test_inherited_start_up_hook_fails(monkeypatch):
    monkeypatch.setenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', '1')
    monkeypatch.setenv('LD_LIBRARY_PATH', '/somewhere/else/lib')
    assert [f.status for f in doctor.check_python()] == ['OK', 'FAIL']
    monkeypatch.setenv('LD_LIBRARY_PATH', f'{sys.prefix}/lib')
    assert [f.status for f in doctor.check_python()] == ['OK']


def test_leaked_segments_are_those_nobody_locks(tmp_path):
    for name in ('dead', 'alive'):
        (tmp_path / f'fastrtps_{name}').write_bytes(b'x')
        (tmp_path / f'fastrtps_{name}_el').touch()
    (tmp_path / 'somebody_elses').touch()
    # the lock must be another process's: only those survive this one's opening and closing the file
    code = (
        'import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_EX); '
        'print("locked", flush=True); sys.stdin.read()'
    )
    holder = subprocess.Popen(
        [sys.executable, '-c', code, str(tmp_path / 'fastrtps_alive_el')],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert holder.stdout.readline() == 'locked\n'
        assert {p.name for p in leaked_segments(tmp_path)} == {'fastrtps_dead', 'fastrtps_dead_el'}
    finally:
        holder.communicate()
    assert len(leaked_segments(tmp_path)) == 4


def test_shared_locks_count_as_in_use(tmp_path):
    lock = tmp_path / 'fastrtps_port7411_el'
    lock.touch()
    with lock.open() as held:
        fcntl.flock(held, fcntl.LOCK_SH)
        assert leaked_segments(tmp_path) == []
    assert leaked_segments(tmp_path) == [lock]


def broken(tmp_path, package, code):
    """A folder to put into PYTHONPATH, with a package that is not what it should be."""
    (tmp_path / package).mkdir()
    (tmp_path / package / '__init__.py').write_text(code)
    return str(tmp_path)


def statuses(findings):
    return {f.subject: (f.status, f.text, f.advice) for f in findings}


def test_another_numpy_in_the_way_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv('PYTHONPATH', broken(tmp_path, 'numpy', '__version__ = "1.19.5"'))
    status, text, advice = statuses(doctor.check_numpy())['numpy']
    assert status == 'FAIL'
    assert text.startswith(f'1.19.5 of {tmp_path}')
    assert 'PYTHONPATH' in advice
    monkeypatch.delenv('PYTHONPATH')
    assert list(doctor.check_numpy()) == []


def test_doctor_itself_lives_where_numpy_does_not(tmp_path):
    """It is run when all else fails, so it has to start, report what is wrong and continue."""
    code = 'raise ImportError("numpy.core.multiarray failed to import")'
    environment = os.environ | {'PYTHONPATH': broken(tmp_path, 'numpy', code), 'ROS_DOMAIN_ID': '62'}
    done = subprocess.run(
        [sys.executable, '-m', 'debris_scanner', 'doctor'],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert 'Traceback' not in done.stdout + done.stderr
    assert 'FAIL  numpy: ImportError: numpy.core.multiarray failed to import' in done.stdout
    assert '-m pip install --force-reinstall numpy==' in done.stdout
    assert 'disk: ' in done.stdout


def test_a_middleware_that_is_not_there(monkeypatch):
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    status, text, advice = statuses(doctor.check_ros())['ros']
    assert status == 'FAIL'
    assert 'rmw_cyclonedds_cpp' in text
    assert advice.startswith('unset RMW_IMPLEMENTATION, or install rmw-cyclonedds-cpp')


def test_no_ros_at_all(monkeypatch, tmp_path):
    monkeypatch.setenv('PYTHONPATH', broken(tmp_path, 'rclpy', 'raise ImportError("no rclpy here")'))
    status, text, advice = statuses(doctor.check_ros())['ros']
    assert (status, text) == ('FAIL', 'ImportError: no rclpy here')
    assert 'source /opt/ros/jazzy/setup.bash' in advice


def test_a_prefix_path_that_leads_nowhere(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, 'ask_python', lambda code: ('rmw_fastrtps_cpp', ''))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/gone:{tmp_path}')
    lost, unnamed = [f for f in doctor.check_ros() if f.subject == 'AMENT_PREFIX_PATH']
    assert (lost.status, unnamed.status) == ('WARN', 'WARN')
    assert lost.text.endswith(f'do not exist: {tmp_path}/gone')
    assert 'unset AMENT_PREFIX_PATH' in lost.advice
    (tmp_path / 'lib' / 'debris_scanner').mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    (found,) = [f for f in doctor.check_ros() if f.subject == 'AMENT_PREFIX_PATH']
    assert found.status == 'OK'


@pytest.mark.parametrize('there', [True, False])
def test_without_a_ros2_command_it_says_how_nodes_start(monkeypatch, there):
    monkeypatch.setattr(doctor, 'ask_python', lambda code: ('rmw_fastrtps_cpp', ''))
    monkeypatch.setattr(doctor.shutil, 'which', lambda name: '/bin/ros2' if there else None)
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    found = statuses(doctor.check_ros())
    assert ('ros2' in found) != there and ('AMENT_PREFIX_PATH' in found) == there
    if not there:
        assert f'{sys.prefix}/lib/debris_scanner' in found['ros2'][1]


@pytest.mark.parametrize('free', [10, 0.5])
def test_too_small_shared_memory(monkeypatch, free):
    usage = namedtuple('Usage', 'total used free')(64 << 20, 0, int(free * (1 << 20)))
    monkeypatch.setattr(middleware.shutil, 'disk_usage', lambda folder: usage)
    status, text, advice = statuses(f for f in doctor.check_shared_memory() if 'MB free' in f.text)[
        'shared memory'
    ]
    assert status == 'WARN'
    assert 'of 64 MB free' in text
    assert '--shm-size=512m' in advice


def test_warm_compiles_and_says_how_long_it_took(monkeypatch, capsys):
    done = []
    monkeypatch.setattr('debris_scanner.warm_up.warm_up', lambda: done.append(True))
    monkeypatch.setattr(doctor, 'CHECKS', ())
    assert main(['doctor', '--warm']) == 0
    assert done == [True]
    assert 'OK    kernels: ready after 0.0 s' in capsys.readouterr().out
