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

"""A batch from its inputs to its tables: what is done is left out, what is not is accounted for."""

import contextlib
import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from debris_scanner import __version__
from debris_scanner.batch import BatchError, sources
from debris_scanner.batch.engine import Cluster, Engine, Surroundings
from debris_scanner.batch.inputs import Recording, find_recordings
from debris_scanner.batch.page import FAILED, render
from debris_scanner.batch.recording import BAD_INPUT, LOG, Job, Row, Scan, scan_recording
from debris_scanner.batch.storage import RECORD, Claim, Place, leftovers, records, words
from debris_scanner.batch.tables import csv_bytes, parquet_bytes
from debris_scanner.batch.worker import Outcome, Task
from debris_scanner.core.parameters import flatten, load
from debris_scanner.settings import Settings

CSV, PARQUET, INDEX = 'batch.csv', 'batch.parquet', 'index.html'
PENDING, FAILURE = 'pending', 'failed'
PRELOAD = (
    'debris_scanner.batch.recording',
    'debris_scanner.batch.sources:program',
    'debris_scanner.core.open3d_library:load_open3d',
    'debris_scanner.scanner',
    'debris_scanner.io.result_files',
    'debris_scanner.report.page',
    'plotly.graph_objects:Figure',
    'debris_scanner.report.scan_output',
    'msg_adapters.bags',
    # named by no import: each is loaded where it is first called, which would be in every task anew
    'scipy.ndimage',
    'scipy.optimize',
    'scipy.spatial',
)
_TABLES_EVERY_S = 60.0


@dataclass(frozen=True)
class Batch:
    """What to do."""

    inputs: Sequence[str]
    out: str  # folder or URL
    scan: Scan
    parameters: Path | None = None
    cluster: Cluster = field(default_factory=Cluster)
    retries: int = 1
    preload: Sequence[str] = ()  # modules of ``scan``
    seconds: float | None = None  # that a recording may take


class Rows:
    """The rows of a batch, and the files that show them."""

    def __init__(self, out: Place) -> None:
        self._out = out
        self._rows: dict[str, Row] = {}
        self._written_s = time.monotonic()

    def __getitem__(self, name: str) -> Row:
        return self._rows[name]

    def put(self, name: str, row: Row, write: bool = True) -> None:
        """Set a recording's row; the files follow within a minute."""
        self._rows[name] = row
        if write and time.monotonic() - self._written_s > _TABLES_EVERY_S:
            with contextlib.suppress(Exception):  # a full disk now is one more reason to go on until the end
                self.write()

    def write(self) -> None:
        """Write the tables and the page.

        Raises:
            OSError: one cannot be written.
        """
        rows = [self._rows[name] for name in sorted(self._rows)]
        (self._out / CSV).write(csv_bytes(rows))
        (self._out / PARQUET).write(parquet_bytes(rows))
        (self._out / INDEX).write(render(rows, self._out.name or self._out.url).encode())
        self._written_s = time.monotonic()

    def counts(self, names: Sequence[str]) -> dict[str, int]:
        """How many of these recordings came to which result."""
        found: dict[str, int] = {}
        for name in names:
            result = str(self._rows[name]['result'])
            found[result] = found.get(result, 0) + 1
        return found


def run_batch(batch: Batch, say: Callable[[str], None]) -> dict[str, int]:
    """Scan all recordings that are not done yet, and write the tables.

    Args:
        batch: what to do.
        say: told what a user wants to know.

    Returns:
        The number of recordings by result.

    Raises:
        BatchError: nothing to do, another batch in the same folder, or a cluster that is lost.
        KeyboardInterrupt: the tables tell what is done.
    """
    text, parameters = _parameters(batch.parameters)
    recordings = find_recordings(batch.inputs)
    program = sources.program()
    out = Place(batch.out)
    with Claim(out):
        for place in leftovers(out):
            place.remove()
        rows, todo = _to_do(out, recordings, parameters, program)
        say(f'{len(recordings)} recordings, {len(recordings) - len(todo)} of them done already')
        jobs = {r.name: Job(r, out.absolute, batch.scan, text, parameters, program) for r in todo}
        try:
            if jobs:
                with Engine(batch.cluster, say) as engine:
                    engine.run(
                        [Task(name, scan_recording, (job,)) for name, job in jobs.items()],
                        lambda outcome: _account(outcome, jobs[outcome.key], out, rows),
                        title='batch',
                        unit='recording',
                        retries=batch.retries,
                        inside=Surroundings(
                            preload=[*PRELOAD, *batch.preload, *_file_systems(batch)], seconds=batch.seconds
                        ),
                    )
        except (KeyboardInterrupt, BatchError):
            counts = rows.counts([r.name for r in recordings])
            say(f'{counts.get(PENDING, 0)} recordings are left; the same command goes on with them')
            raise
        finally:
            try:
                rows.write()
            except Exception as error:
                raise BatchError(f'cannot write the tables to {out.url}: {words(error)}') from error
    return rows.counts([r.name for r in recordings])


def _file_systems(batch: Batch) -> list[str]:
    """Modules of the file systems that the workers will use."""
    return sorted({type(Place(url).fs).__module__ for url in (*batch.inputs, batch.out)})


def _parameters(path: Path | None) -> tuple[str | None, str]:
    """The file's content, and the digest of what it sets: comments and order do not matter."""
    settings = load(Settings(), path) if path is not None else Settings()
    digest = hashlib.sha256(json.dumps(flatten(settings), sort_keys=True).encode()).hexdigest()
    return (None if path is None else path.read_text(encoding='utf-8')), digest


def _to_do(
    out: Place, recordings: Sequence[Recording], parameters: str, program: str
) -> tuple[Rows, list[Recording]]:
    """Rows of what is there, those of earlier batches into the same folder too, and what is to be done."""
    names = [r.name for r in recordings]
    others = set(_folders(out)) - set(names)
    rows, todo = Rows(out), []
    for folder in (FAILED, ''):
        for name, record in records(out, sorted(others), folder).items():
            rows.put(name, record['row'], write=False)
    found = records(out, names)
    for recording in recordings:
        record = found.get(recording.name, {})
        key, same = record.get('key', {}), record.get('fingerprint') == recording.fingerprint
        if same and (key.get('parameters'), key.get('program')) == (parameters, program):
            rows.put(recording.name, record['row'], write=False)
        else:
            rows.put(
                recording.name, {'name': recording.name, 'url': recording.url, 'result': PENDING}, write=False
            )
            todo.append(recording)
    return rows, todo


def _folders(out: Place) -> list[str]:
    try:
        entries = [*out.fs.ls(out.path, detail=True)]
    except FileNotFoundError:
        return []
    with contextlib.suppress(FileNotFoundError):
        entries += out.fs.ls(f'{out.path}/{FAILED}', detail=True)
    names = {Place(str(e['name'])).url.rsplit('/', 1)[-1] for e in entries if e['type'] == 'directory'}
    return sorted(n for n in names if n != FAILED and not n.startswith('.'))


def _account(outcome: Outcome, job: Job, out: Place, rows: Rows) -> None:
    """Put down how a recording ended; a failure gets a folder with its log."""
    name = job.recording.name
    failed = out / FAILED / name
    about = {'total_s': round(outcome.seconds, 3), 'worker': outcome.worker, 'attempts': outcome.attempts}
    if outcome.failure is None:
        row = dict(outcome.value)
        if not row.pop('unchanged', False):
            row |= about
            _complete(out / name / RECORD, row)
        with contextlib.suppress(Exception):
            failed.remove()
        rows.put(name, row)
        return
    row = {
        'name': name,
        'url': job.recording.url,
        'result': FAILURE,
        'reason': f'{outcome.failure.kind}: {outcome.failure}',
        'parameters_sha256': job.parameters_digest,
        'program': job.program,
        'version': __version__,
        'finished': datetime.now(UTC).isoformat(timespec='seconds'),
        **about,
    }
    rows.put(name, row)
    with contextlib.suppress(Exception):  # on a full disk the tables at the end are the only account
        (failed / LOG).write((outcome.failure.log or f'{outcome.failure}\n').encode())
        (failed / RECORD).write((json.dumps({'row': row}, indent=1) + '\n').encode())


def _complete(place: Place, row: Row) -> None:
    """Add to a record what only the batch knows; without it the record is whole, too."""
    with contextlib.suppress(Exception):
        record = json.loads(place.read() or b'')
        place.write((json.dumps(record | {'row': row}, indent=1) + '\n').encode())


def unfinished(counts: dict[str, int]) -> int:
    """Recordings without a result."""
    return sum(counts.get(result, 0) for result in (PENDING, FAILURE, BAD_INPUT))
