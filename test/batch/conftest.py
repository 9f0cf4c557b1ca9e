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

"""A Dask cluster and an S3 server on this machine, as processes of their own, and the verb on them."""

import os
import signal
import socket
import subprocess
import sys
from collections import Counter
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest
import stub_scans
from batch_waits import ROOT, until

HERE = Path(__file__).resolve().parent


def free_port():
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        return found.getsockname()[1]


class Cluster:
    """A scheduler and workers; each may be killed."""

    def __init__(self, folder, env, workers=3):
        self._folder, self._env = folder, env
        self.port = free_port()
        self.address = f'tcp://127.0.0.1:{self.port}'
        self.scheduler, self.workers = None, []
        self.start_scheduler()
        for _ in range(workers):
            self.start_worker()

    def start_scheduler(self):
        options = ['--host', '127.0.0.1', '--port', str(self.port), '--no-dashboard']
        self.scheduler = self._start('scheduler', *options)

    def start_worker(self):
        options = ['--nthreads', '1', '--memory-limit', '3GB', '--no-dashboard', '--local-directory']
        self.workers.append(self._start('worker', self.address, *options, str(self._folder)))

    def _start(self, kind, *options):
        command = [sys.executable, '-m', f'distributed.cli.dask_{kind}', *options]
        log = (self._folder / f'{kind}.log').open('ab')
        return subprocess.Popen(command, env=self._env, stdout=log, stderr=log, start_new_session=True)

    def close(self):
        for process in [*self.workers, self.scheduler]:
            end_tree(process)


def end_tree(process):
    if process.poll() is None:
        family = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        for member in family:
            if member.is_running():
                member.kill()
    process.wait()


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """Counts the scans begun by recording; the stub scans find themselves and the file."""
    file = tmp_path / 'begun'
    file.touch()
    monkeypatch.setenv(stub_scans.DONE, str(file))
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(HERE), str(ROOT)]))
    return lambda: Counter(line.removesuffix('.mcap') for line in file.read_text().split())


@pytest.fixture
def cluster(tmp_path, begun):
    folder = tmp_path / 'cluster'
    folder.mkdir()
    made = Cluster(folder, dict(os.environ))
    yield made
    made.close()


@pytest.fixture
def verb(begun, tmp_path):
    """Starts ``debris-scan batch`` with stub scans as a process of its own."""
    started = []

    def start(*options):
        command = [sys.executable, str(HERE / 'stub_scans.py'), 'batch', *map(str, options)]
        started.append(
            subprocess.Popen(
                command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
            )
        )
        return started[-1]

    yield start
    for process in started:
        end_tree(process)


@pytest.fixture
def s3(monkeypatch, tmp_path):
    """URL of an empty bucket on a real server."""
    import s3fs

    port = free_port()
    endpoint = f'http://127.0.0.1:{port}'
    settings = {
        'AWS_ENDPOINT_URL': endpoint,
        'AWS_ACCESS_KEY_ID': 'key',
        'AWS_SECRET_ACCESS_KEY': 'secret',
        'AWS_DEFAULT_REGION': 'us-east-1',
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    log = (tmp_path / 's3.log').open('wb')
    server = subprocess.Popen([sys.executable, '-m', 'moto.server', '-p', str(port)], stdout=log, stderr=log)
    try:
        until(lambda: server.poll() is None and answers(endpoint))
        s3fs.S3FileSystem.clear_instance_cache()
        s3fs.S3FileSystem().mkdir('lab')
        yield 's3://lab'
    finally:
        s3fs.S3FileSystem.clear_instance_cache()
        server.send_signal(signal.SIGKILL)
        server.wait()


def answers(endpoint):
    try:
        with urlopen(endpoint, timeout=2):
            return True
    except OSError:
        return False
