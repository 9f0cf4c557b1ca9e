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

"""A real cluster on loopback, a scheduler and three workers as processes, and a real S3 server.

And the cost of a task.
"""

import csv
import io
import os
import subprocess
import sys
import time

import psutil
import pytest
from batch_waits import ROOT, WAIT_S, until
from stub_scans import recordings, stub

from debris_scanner.batch.engine import Cluster, Engine, Surroundings
from debris_scanner.batch.storage import Place
from debris_scanner.batch.worker import Task
from debris_scanner.cli.main import main

pytestmark = [pytest.mark.faults, pytest.mark.slow]

SCAN_S = 1500


def rows(out):
    text = (Place(str(out)) / 'batch.csv').read().decode()
    return {row['name']: row for row in csv.DictReader(io.StringIO(text))}


def upload(folder, url):
    place = Place(url)
    for path in folder.rglob('*'):
        if path.is_file():
            place.fs.pipe_file(f'{place.path}/{path.relative_to(folder)}', path.read_bytes())


def test_a_scan_by_way_of_a_cluster_and_s3_has_the_bytes_of_scan(s3, cluster, tmp_path):
    """Two recordings out of a store and back into it, one of them with a model."""
    bags, plain = tmp_path / 'bags', tmp_path / 'plain'
    options = ['--spin', '1', '--seconds', '8', '--rate', '5']
    assert main(['simulate', 'cubesat', '--out', str(bags / 'turn'), *options]) == 0
    assert (
        main(['simulate', 'empty', '--motion', 'still', '--seconds', '0.5', '--out', str(bags / 'empty')])
        == 0
    )
    upload(bags, f'{s3}/in')
    command = [sys.executable, '-m', 'debris_scanner', 'batch', f'{s3}/in', '--out', f'{s3}/out']
    command += ['--scheduler', cluster.address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SCAN_S, check=False)
    assert done.returncode == 0, done.stderr
    found = rows(f'{s3}/out')
    assert {n: r['result'] for n, r in found.items()} == {'turn': 'model', 'empty': 'no_model'}
    assert main(['scan', str(bags / 'turn'), '--out', str(plain)]) == 0
    out = Place(f'{s3}/out')
    for name in ('model.ply', 'mesh.ply', 'target_pose.tum', 'graph.g2o'):
        assert (out / 'turn' / name).read() == (plain / name).read_bytes(), name
    assert (out / 'turn' / 'thumbnail.png').read()[:4] == b'\x89PNG'
    assert b'turn/report.html' in (out / 'index.html').read()
    # streamed to the workers and removed after; the lease is given back; nothing is left to do
    scratch = tmp_path / 'cluster'
    assert [p for p in scratch.rglob('*') if p.suffix in ('.mcap', '.ply')] == []
    assert (out / '.batch.lock').read() is None
    again = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S, check=False)
    assert again.returncode == 0 and '2 of them done already' in again.stderr


def test_a_cluster_whose_workers_and_scheduler_are_killed(cluster, verb, begun, tmp_path):
    bags = recordings(tmp_path / 'bags', **{f'r{k}': 'slow 2' for k in range(12)})
    out = tmp_path / 'out'
    command = [bags, '--out', out, '--scheduler', cluster.address, '--retries', '2']
    batch = verb(*command)
    until(lambda: begun().total() >= 4)
    # of one worker its nanny and all below it: it does not come back
    for member in [*psutil.Process(cluster.workers[0].pid).children(recursive=True), cluster.workers[0]]:
        member.kill()
    until(lambda: len(list(out.glob('*/batch.json'))) >= 5)
    cluster.scheduler.kill()
    errors = batch.communicate(timeout=WAIT_S)[1]
    assert batch.returncode == 2, errors
    assert 'Traceback' not in errors and 'the same command goes on' in errors
    assert len(rows(out)) == 12
    # what was under way on the workers may have ended since
    complete = {p.parent.name for p in out.glob('*/batch.json')}
    before = begun()
    assert sum(n - 1 for n in before.values()) <= 1
    cluster.scheduler.wait()
    cluster.start_scheduler()
    cluster.start_worker()
    assert verb(*command).wait(WAIT_S) == 0
    assert {r['result'] for r in rows(out).values()} == {'no_model'}
    assert all(begun()[name] == before[name] for name in complete)


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path):
    bags = recordings(tmp_path / 'bags', a='')
    command = [sys.executable, '-m', 'debris_scanner', 'batch', str(bags), '--out', str(tmp_path / 'out')]
    done = subprocess.run(
        [*command, '--scheduler', 'tcp://127.0.0.1:1'], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert 'no Dask scheduler answers at tcp://127.0.0.1:1' in done.stderr and 'Traceback' not in done.stderr


@pytest.mark.timing
def test_ten_thousand_tasks(cluster, begun):
    """What the engine costs a task, in the processor time of scheduler and client, and in memory."""
    count, found = 10_000, []
    scheduler, client = psutil.Process(cluster.scheduler.pid), psutil.Process(os.getpid())

    def spent():
        return sum(sum(p.cpu_times()[:2]) for p in (scheduler, client))

    with Engine(Cluster(scheduler=cluster.address)) as engine:
        until(lambda: engine.slots == 3)
        cpu, start = spent(), time.monotonic()
        tasks = [Task(f't{k}', stub, (k,)) for k in range(count)]
        engine.run(tasks, found.append, title='stub', inside=Surroundings(isolated=False))
        wall, cpu = time.monotonic() - start, spent() - cpu
        memory = scheduler.memory_info().rss
    assert sorted(o.value for o in found) == list(range(count))
    print(f'{1e3 * wall / count:.2f} ms, {1e3 * cpu / count:.2f} ms of cpu a task, {memory / 1e6:.0f} MB')
    assert memory < 1e9
    assert cpu / count < 5e-3
