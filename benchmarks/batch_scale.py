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

"""What a batch costs on a cluster and an S3 store: how much a recording, and which process limits it.

A scheduler, workers of one thread and an S3 server (moto) are processes on this machine. First come
recordings whose scan does nothing, then real ones, each under several names:

    python -m benchmarks.batch_scale FOLDER_OF_BAGS --workers 10 --stubs 1000 --real 50

Times are of the processor, so the processes may share cores. A worker has a core; how many of them the
busiest of the single processes can serve is the bound on a cluster.
"""

import argparse
import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from urllib.request import urlopen

import psutil

from benchmarks.scorecard.tables import markdown
from debris_scanner.batch.engine import Cluster
from debris_scanner.batch.fleet import Batch, run_batch
from debris_scanner.batch.recording import Scan
from debris_scanner.batch.storage import Place
from debris_scanner.cli.batch import scan_quietly
from debris_scanner.core.results import NO_TARGET
from debris_scanner.io.result_files import ScanResult, write_results

START_S = 60.0
MEMORY = '3GB'  # of a worker
SINGLE = ('client', 'scheduler', 'store')  # of which there is one, however many workers there are
STUB = b'not looked at' * 300
PRELOAD = ('debris_scanner.cli.batch', 'debris_scanner.cli.scan', 'debris_scanner.cli.outcome')


def stub_scan(bag: Path, out: Path, params: Path | None) -> None:
    """A scan that costs nothing: what is left is the batch's own."""
    write_results(out, ScanResult(NO_TARGET, None), 0.0)


class Site:
    """A scheduler, its workers and a store; as a context it ends them."""

    def __init__(self, workers: int, folder: Path) -> None:
        """Start them.

        Args:
            workers: of one thread each.
            folder: for what the workers write, and the log.
        """
        store, scheduler = _free_port(), _free_port()
        self.address = f'tcp://127.0.0.1:{scheduler}'
        os.environ |= {
            'AWS_ENDPOINT_URL': f'http://127.0.0.1:{store}',
            'AWS_ACCESS_KEY_ID': 'key',
            'AWS_SECRET_ACCESS_KEY': 'secret',
            'AWS_DEFAULT_REGION': 'us-east-1',
        }
        self._log = (folder / 'log').open('wb')
        host = ('--host', '127.0.0.1', '--no-dashboard', '--port', str(scheduler))
        thread = ('--nthreads', '1', '--memory-limit', MEMORY, '--no-dashboard', '--local-directory')
        self._processes = {
            'store': [self._start('moto.server', '-p', str(store))],
            'scheduler': [self._start('distributed.cli.dask_scheduler', *host)],
            'workers': [
                self._start('distributed.cli.dask_worker', self.address, *thread, str(folder))
                for _ in range(workers)
            ],
        }
        _wait_for(f'http://127.0.0.1:{store}')

    def __enter__(self) -> 'Site':
        return self

    def __exit__(self, *error: object) -> None:
        for process in [p for members in self._processes.values() for p in members]:
            for member in [*process.children(recursive=True), process]:
                with contextlib.suppress(psutil.Error):
                    member.kill()
        self._log.close()

    def cpu_s(self) -> dict[str, float]:
        """Processor time so far by kind of process, in seconds; of tasks that ended, too."""
        spent = {kind: sum(map(_cpu_s, members)) for kind, members in self._processes.items()}
        return spent | {'client': time.process_time()}

    def _start(self, module: str, *options: str) -> psutil.Process:
        command = [sys.executable, '-m', module, *options]
        return psutil.Process(subprocess.Popen(command, stdout=self._log, stderr=self._log).pid)


def _cpu_s(process: psutil.Process) -> float:
    total = 0.0
    for member in [process, *process.children(recursive=True)]:
        with contextlib.suppress(psutil.Error):
            total += sum(member.cpu_times()[:4])  # its own, and of children that ended
    return total


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        return int(found.getsockname()[1])


def _wait_for(url: str) -> None:
    until = time.monotonic() + START_S
    while True:
        try:
            with urlopen(url, timeout=2):
                return
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.2)


def upload(bags: Sequence[Path], count: int, out: Place) -> None:
    """Put recordings into the store, each under several names until there are so many."""
    for k, bag in enumerate(islice(cycle(bags), count)):
        for path in sorted(bag.iterdir()):
            out.fs.pipe_file(f'{out.path}/{bag.name}_{k}/{path.name}', path.read_bytes())


def measure(site: Site, what: str, scan: Scan, count: int) -> list[str]:
    """Scan what lies in a folder of the store; a row of the table.

    Args:
        site: where.
        what: the folder.
        scan: that each recording gets.
        count: of the recordings.
    """
    before, start = site.cpu_s(), time.monotonic()
    batch = Batch(
        [f's3://lab/{what}'],
        f's3://lab/{what}_out',
        scan,
        cluster=Cluster(scheduler=site.address),
        preload=PRELOAD,
    )
    found = run_batch(batch, lambda text: print(text, file=sys.stderr))
    wall = time.monotonic() - start
    spent = {kind: (after - before[kind]) / count for kind, after in site.cpu_s().items()}
    out = Place(f's3://lab/{what}_out')
    size = sum(out.fs.du(out.path, total=False).values()) / count
    busiest = max(SINGLE, key=spent.__getitem__)
    results = ', '.join(f'{n} {result}' for result, n in sorted(found.items()))
    return [
        f'{count} {what}: {results}',
        f'{wall:.0f}',
        *(f'{1e3 * spent[kind]:.0f}' for kind in ('workers', *SINGLE)),
        f'{size / 1e6:.2f}',
        f'{spent["workers"] * 1000 / 3600:.2f}',
        f'{busiest}, {spent["workers"] / spent[busiest]:.0f}',
    ]


def main() -> int:
    """Run both and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('bags', type=Path, metavar='FOLDER_OF_BAGS')
    parser.add_argument('--workers', type=int, default=10, metavar='N')
    parser.add_argument('--stubs', type=int, default=1000, metavar='N')
    parser.add_argument('--real', type=int, default=50, metavar='N')
    args = parser.parse_args()
    bags = sorted(p.parent for p in args.bags.glob('*/metadata.yaml'))
    if not bags:
        parser.error(f'{args.bags} holds no bag')
    with tempfile.TemporaryDirectory() as name, Site(args.workers, Path(name)) as site:
        store = Place('s3://lab')
        store.fs.mkdir('lab')
        for k in range(args.stubs):
            store.fs.pipe_file(f'lab/stubs/stub_{k}.mcap', STUB + str(k).encode())
        upload(bags, args.real, store / 'real')
        rows = [
            measure(site, 'stubs', stub_scan, args.stubs),
            measure(site, 'real', scan_quietly, args.real),
        ]
    columns = [f'{kind}, ms' for kind in ('workers', *SINGLE)]
    header = [
        'recordings',
        'wall, s',
        *columns,
        'MB out',
        'core-hours for 1000',
        'bound, and workers it serves',
    ]
    print(markdown(header, rows), end='')
    return 0


if __name__ == '__main__':
    sys.exit(main())
