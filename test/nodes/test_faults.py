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

"""What goes wrong around a live scan, made to happen to real nodes; docs/reliability.md tells the outcome."""

import itertools
import re
import resource
import subprocess
import time

import numpy as np
import psutil
import pytest
from altered_bags import altered
from live_runs import LiveRun, holds_the_bounds
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from test_preprocess import FRAME, disc_cloud, garbage

from debris_scanner.cli.main import main
from debris_scanner.io.result_files import MODEL_FILES
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.tracking.gating import OdometrySettings

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.faults]
S = 1_000_000_000


def evaluated(live, bag):
    assert main(['evaluate', str(live.out), '--truth', str(bag)]) == 0
    return live.metrics


def whole(folder):
    """Every file of a result is there and none is a part of one."""
    assert not [p.name for p in folder.iterdir() if p.name.endswith('.part')]
    for name in MODEL_FILES:
        assert (folder / name).stat().st_size > 1000
    vertices = int((folder / 'model.ply').read_bytes()[:400].split(b'element vertex ')[1].split()[0])
    assert vertices > 5000


def test_a_fifth_of_all_frames_is_lost(tmp_path, session_bag):
    lost = np.random.default_rng(7).random(250) < 0.2
    bag = altered(session_bag, tmp_path / 'bag', lambda k: None if lost[k] else (0, 0))
    runs = [len(list(run)) for gone, run in itertools.groupby(lost) if gone]
    # the first frame after a gap only tells whether the target is still coming into sight
    unused = sum(run + 1 > OdometrySettings().lost_after for run in runs)
    live = LiveRun(tmp_path / 'out', '--bag', bag)
    assert live.end() == 0, live.errors
    assert live.summary['frames']['used'] == 250 - lost.sum() - unused
    holds_the_bounds(evaluated(live, bag))


def test_the_sensor_is_silent_for_half_a_minute(tmp_path, session_bag):
    """Two turns go by unseen; the target is found again by its model."""
    period_ns = round(4 * np.pi * S)  # of the recorded spin

    def silent(k):
        if 160 <= k < 210:
            return None
        return (0, 0) if k < 160 else (2 * period_ns, 2 * period_ns)

    bag = altered(session_bag, tmp_path / 'bag', silent)
    live = LiveRun(tmp_path / 'out', '--bag', bag)
    assert live.end() == 0, live.errors
    frames = live.summary['frames']
    assert frames['read'] == 200
    # ten that confirm what a search found, and at 10 Hz those that pass during two searches
    searching = 2 * live.summary['timing']['tracking']['p99_ms'] / 100
    assert frames['used'] >= 190 - searching, frames
    metrics = evaluated(live, bag)
    assert metrics['verdict'] == 'right'
    assert metrics['attitude_deg']['max'] <= 1.0


@pytest.mark.parametrize('jump_s', [-3600, 3600])
def test_the_sensors_clock_is_set_while_it_scans(tmp_path, session_bag, jump_s):
    start_s = 7200  # the recording begins at 0 s, and before that there is no time
    bag = altered(session_bag, tmp_path / 'bag', lambda k: (0, (start_s + (0 if k < 60 else jump_s)) * S))
    live = LiveRun(tmp_path / 'out', '--bag', bag)
    assert live.end() == 0, live.errors
    summary = live.summary
    assert summary['result'] == 'model'
    frames, rejected = summary['frames'], dict(summary['frames']['rejected'])
    assert frames['read'] == 250 == frames['used'] + sum(rejected.values())
    # a slow machine sheds a few while the model is made
    assert rejected.pop('shed', 0) <= 5 and rejected == {'non_monotone_stamp': 2}
    log = (live.out / 'logs' / 'preprocess.log').read_text()
    way = 'back' if jump_s < 0 else 'forward'
    assert re.search(rf'stamps jumped {way} by 3(600\.0|599\.9)', log)  # as the frames came


def test_interrupted_while_it_generates(tmp_path):
    live = LiveRun(tmp_path / 'out', '--simulate', 'shuttle_stack', '--spin', 1.0)
    live.until_said('generating ')
    live.interrupt()
    assert live.end() in (0, 3), live.errors
    summary = live.summary
    assert not [p for p in live.out.iterdir() if p.name.endswith('.part')]
    if summary['result'] == 'model':
        whole(live.out)
    else:
        assert summary['reason'] == 'interrupted'


def test_the_disk_is_full_while_it_saves(tmp_path):
    """A limit on the size of files stands in for a full disk; it goes when there is room again."""
    live = LiveRun(tmp_path / 'out', '--simulate', 'shuttle_stack', '--spin', 1.0, '--track-seconds', 12)
    live.until_said('scanning')
    graph = live.node('graph')
    resource.prlimit(graph.pid, resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))
    log = live.out / 'logs' / 'graph.log'
    live.until(lambda: 'not saved: cannot write' in log.read_text(), 'an attempt to save')
    assert 'File too large' in log.read_text()
    live.until_said('tracking ')
    assert not (live.out / '.saving').exists()
    assert not [p for p in live.out.iterdir() if p.name.endswith('.part')]
    assert not (live.out / 'summary.json').exists()
    assert graph.is_running()
    resource.prlimit(graph.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert live.end() == 0, live.errors
    whole(live.out)
    holds_the_bounds(live.metrics)


def own_shared_memory(size, then):
    """Prefix of a command that gives it a /dev/shm of its own; skips where that is not permitted."""
    mount = f'mount -t tmpfs -o size={size} tmpfs /dev/shm'
    own = ['unshare', '-m', 'sh', '-c']
    if subprocess.run([*own, mount], capture_output=True, check=False).returncode:
        pytest.skip('a mount of our own is not permitted here')
    return [*own, f'{mount} && {then} exec "$@"', 'sh']


@pytest.mark.parametrize('size', ['16m', '100m'])
def test_shared_memory_is_small(tmp_path, size):
    live = LiveRun(
        tmp_path / 'out',
        *('--simulate', 'shuttle_stack', '--spin', 1.0, '--track-seconds', 4),
        prefix=own_shared_memory(size, ''),
    )
    assert live.end() == 0, live.errors
    assert 'MB free' in live.errors
    assert live.summary['frames']['rejected'].get('lost_in_transport', 0) <= 3
    holds_the_bounds(live.metrics)


@pytest.mark.parametrize('moment', ['before it starts', 'while it scans'])
def test_shared_memory_is_filled_by_others(tmp_path, moment):
    flag = tmp_path / 'fill'
    fill = 'dd if=/dev/zero of=/dev/shm/fill bs=1M count={} 2>/dev/null;'
    then = {
        'before it starts': fill.format(699),  # the last MB is left: without a page ROS does not load
        'while it scans': f'(while [ ! -e {flag} ]; do sleep 0.2; done; {fill.format(700)}) &',
    }
    live = LiveRun(
        tmp_path / 'out',
        *('--simulate', 'shuttle_stack', '--spin', 1.0, '--track-seconds', 4),
        prefix=own_shared_memory('700m', then[moment]),
    )
    live.until_said('scanning')
    flag.touch()
    assert live.end() == 0, live.errors
    assert live.summary['frames']['rejected'].get('lost_in_transport', 0) <= 12  # by UDP
    holds_the_bounds(live.metrics)


def test_shared_memory_is_full(tmp_path):
    fill = 'dd if=/dev/zero of=/dev/shm/fill bs=1M 2>/dev/null;'
    live = LiveRun(tmp_path / 'out', '--simulate', 'shuttle_stack', prefix=own_shared_memory('1m', fill))
    assert live.end() == 2
    (line,) = live.errors.splitlines()
    assert (
        line == 'debris-scan live: shared memory is full, so ROS cannot be loaded: delete files in /dev/shm'
    )


def test_a_flood_of_garbage_is_survived(nodes, peer):
    nodes.start('preprocess', ['--ros-args', '-p', 'input:=points'])
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points', qos.cloud_publisher())
    process = psutil.Process(nodes._children['preprocess'].process.pid)
    stamps = itertools.count(1)
    peer.until(lambda: points.publish(disc_cloud(next(stamps))) or targets, 'a target before')
    before = process.memory_info().rss
    clouds = garbage()
    noise = np.random.default_rng(0)
    raw = [serialize_message(c) for c in clouds]
    end, sent = time.monotonic() + 10, 0
    while time.monotonic() < end:
        points.publish(clouds[sent % len(clouds)])
        data = bytearray(raw[sent % len(raw)])
        for at in noise.integers(4, len(data), 8):
            data[at] = noise.integers(256)
        points.publish(bytes(data))
        sent += 2
        if sent % 50 == 0:
            points.publish(disc_cloud(S + sent))
            peer.executor.spin_once(0.0)
    good = len(targets)
    # where the noise hit a stamp, the first frames are of a clock that was set
    peer.until(
        lambda: points.publish(disc_cloud(9 * S + next(stamps))) or len(targets) > good, 'a target afterwards'
    )
    assert targets[-1].header.frame_id == FRAME
    nodes.check()
    peer.until(lambda: peer.rejected('preprocess').get('malformed', 0) > 20, 'what was rejected')
    assert sent > 500
    assert process.memory_info().rss - before < 150e6


def test_two_scanners_on_one_domain(nodes, peer, tmp_path):
    """In namespaces of their own they do not hear each other."""
    for name, target in (('a', 'shuttle_stack'), ('b', 'cubesat')):
        remap = ['-r', f'__ns:=/{name}']
        given = ['-p', f'output_dir:={tmp_path / name}', '-p', 'input_reliability:=reliable']
        nodes.start('scanner', ['--ros-args', *remap, *given], called=f'scanner_{name}')
        camera = [f'target:={target}', 'seconds:=9.0', 'spin_rad_s:=1.0', 'wait_for_stages:=scanner']
        camera += ['range_m:=1.6']  # few pixels: two scans on two slow cores
        nodes.start(
            'sim_kinect',
            ['--ros-args', *remap, *(p for c in camera for p in ('-p', c))],
            called=f'sim_kinect_{name}',
        )
    for name in 'ab':
        nodes.wait(f'sim_kinect_{name}', 120)
        answer = peer.call(Trigger, f'{name}/scanner/finish')
        assert answer.success, answer.message
        summary = LiveRun.summary.fget(type('Run', (), {'out': tmp_path / name}))
        assert summary['result'] == 'model'
        frames = summary['frames']
        assert frames['read'] == 90
        assert set(frames['rejected']) <= {'shed'}, frames  # two on two cores may be one too many
        assert frames['used'] >= 80, frames


def test_two_scanners_under_one_name_are_told_so(nodes, peer):
    for k in (1, 2):
        nodes.start('preprocess', called=f'preprocess_{k}')
    peer.until(
        lambda: (
            'preprocess' in peer.reports
            and '2 nodes are called /preprocess' in peer.reports['preprocess'].message
        ),
        'a word on the other one',
    )


def test_nothing_is_written_beside_out(tmp_path, session_bag):
    home, work, out = tmp_path / 'home', tmp_path / 'work', tmp_path / 'out'
    for folder in (home, work):
        folder.mkdir()
    live = LiveRun(out, '--bag', session_bag, cwd=work, HOME=str(home))
    live.until_said('tracking ')
    live.kill('graph')
    assert live.end() == 0, live.errors
    assert [p for folder in (home, work) for p in folder.rglob('*') if p.is_file()] == []
    assert not list(work.iterdir())


def test_impatient_and_patient_ends_of_a_node(nodes, peer, tmp_path):
    """SIGTERM while nothing was seen leaves a summary that says so."""
    nodes.start('graph', ['--ros-args', '-p', f'output_dir:={tmp_path / "out"}'])
    peer.until(lambda: peer.reports.get('graph'), 'a report')
    nodes._children['graph'].process.terminate()
    assert nodes.wait('graph', 60)
    assert nodes.exit_code('graph') == 0
    assert (tmp_path / 'out' / 'summary.json').is_file()
