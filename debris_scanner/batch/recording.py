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

"""One recording on a worker, in a process of its own: fetch, scan, report, publish."""

import json
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from debris_scanner import __version__
from debris_scanner.batch import sources
from debris_scanner.batch.inputs import Recording
from debris_scanner.batch.storage import RECORD, Place, fetch, records
from debris_scanner.batch.template import Progress
from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import CAMERA_INFO
from debris_scanner.io.files import write_atomically
from debris_scanner.io.mesh_files import read_mesh
from debris_scanner.io.result_files import REPORT, SUMMARY

LOG = 'log.txt'
THUMBNAIL = 'thumbnail.png'
BAD_INPUT = 'bad_input'
_SIZE = 160  # pixels of a thumbnail
_SEEN_FROM = np.radians([-25.0, 35.0, 0.0])  # a little from above and from one side
_AWAY = 4.0  # of the camera, in extents of the model
_LIGHT = np.array([-0.4, -0.6, -0.7]) / np.linalg.norm([-0.4, -0.6, -0.7])
_COLOUR = np.array([180.0, 198.0, 218.0])

Row = dict[str, Any]


class BadRecording(Exception):
    """A recording that cannot be scanned, whoever tries: the same input would fail again."""


# bag, output folder, parameter file or None; raises BadRecording
Scan = Callable[[Path, Path, Path | None], None]


@dataclass(frozen=True)
class Job:
    """What a worker needs to know to scan one recording."""

    recording: Recording
    out: str  # URL of the batch's output folder
    scan: Scan  # pickled by its name
    parameters: str | None  # content of the parameter file
    parameters_digest: str
    program: str  # digest that the worker's own must equal


def scan_recording(job: Job, progress: Progress) -> Row:
    """Scan one recording and publish its folder, unless its results are there already.

    Returns:
        The recording's row; ``unchanged`` in it says that nothing had to be done.

    Raises:
        RuntimeError: this worker has another program than the batch.
        OSError: something cannot be read or written.
    """
    _check_program(job.program)
    begin, cpu = time.perf_counter(), time.process_time()
    recording, work = job.recording, Path.cwd()
    progress(0.0, 'fetch')
    paths, sha, size = fetch({n: Place(u) for n, u in recording.files}, work / 'bag' / recording.name)
    key = {'input': sha, 'parameters': job.parameters_digest, 'program': job.program}
    fetched_s = time.perf_counter() - begin
    out = Place(job.out)
    earlier = records(out, [recording.name]).get(recording.name)
    if earlier is not None and earlier.get('key') == key:  # touched, or done by a worker that was lost since
        earlier |= {'fingerprint': recording.fingerprint}
        (out / recording.name / RECORD).write(_encoded(earlier))
        return {**earlier['row'], 'unchanged': True}
    result = work / 'out'
    result.mkdir()
    progress(0.1, 'scan')
    bag = work / 'bag' / recording.name if recording.folder else next(iter(paths.values()))
    status, reason = _scan(job.scan, bag, result, _parameter_file(job, work))
    progress(0.9, 'report')
    if (result / SUMMARY).is_file():
        _illustrate(result)
    row = {
        **_figures(result),
        'name': recording.name,
        'url': recording.url,
        'result': status,
        'reason': reason,
        'fetch_s': round(fetched_s, 3),
        'cpu_s': round(time.process_time() - cpu, 3),
        'input_bytes': size,
        'input_sha256': sha,
        'parameters_sha256': job.parameters_digest,
        'program': job.program,
        'version': __version__,
        'finished': datetime.now(UTC).isoformat(timespec='seconds'),
    }
    _complete(result, work.parent / LOG, {'key': key, 'fingerprint': recording.fingerprint, 'row': row})
    progress(0.95, 'publish')
    (out / recording.name).publish(result)
    return row


def _check_program(batch: str) -> None:
    if (own := sources.program()) != batch:
        raise RuntimeError(
            f'this worker has debris_scanner {__version__} of sources {own}, the batch {batch}: '
            'install the same release on every machine'
        )


def _parameter_file(job: Job, work: Path) -> Path | None:
    if job.parameters is None:
        return None
    path = work / 'parameters.yaml'
    path.write_text(job.parameters, encoding='utf-8')
    return path


def _complete(result: Path, log: Path, record: dict[str, Any]) -> None:
    """Put the log and the record into a result; its row says how large it is."""
    sys.stdout.flush()
    sys.stderr.flush()
    shutil.copyfile(log, result / LOG)
    record['row']['output_bytes'] = sum(p.stat().st_size for p in result.iterdir())
    write_atomically(result / RECORD, _encoded(record))


def _encoded(record: dict[str, Any]) -> bytes:
    return (json.dumps(record, indent=1, allow_nan=False) + '\n').encode()


def _scan(scan: Scan, bag: Path, result: Path, parameters: Path | None) -> tuple[str, str | None]:
    try:
        scan(bag, result, parameters)
    except BadRecording as error:
        print(error, file=sys.stderr)
        return BAD_INPUT, str(error)
    summary = json.loads((result / SUMMARY).read_bytes())
    if summary['reason'] == CAMERA_INFO:  # as the verb scan has it
        return BAD_INPUT, f'{CAMERA_INFO}: {summary.get("hint", "")}'
    return summary['result'], summary['reason']


def _figures(folder: Path) -> Row:
    """What the tables tell of a scan."""
    if not (folder / SUMMARY).is_file():
        return {}
    summary = json.loads((folder / SUMMARY).read_bytes())
    frames, model, coverage = summary['frames'], summary['model'] or {}, summary['coverage'] or {}
    return {
        'frames_read': frames['read'],
        'frames_used': frames['used'],
        'keyframes': summary['keyframes'],
        'closures_accepted': sum(c['accepted'] for c in summary['closures']),
        'rotation_period_s': summary['rotation_period_s'],
        'model_points': model.get('points'),
        'model_triangles': model.get('triangles'),
        'observed_share': coverage.get('observed_share'),
        'sensor_sigma_m': (summary['sensor'] or {}).get('sigma_m'),
        'scan_s': summary['wall_s'],
        'peak_rss_mb': summary['peak_rss_mb'],
    }


def _illustrate(folder: Path) -> None:
    """The report, and a picture of the model if there is one."""
    from debris_scanner.report.page import render
    from debris_scanner.report.scan_output import read_scan

    write_atomically(folder / REPORT, render(read_scan(folder)).encode())
    mesh = next((folder / n for n in ('mesh_closed.ply', 'mesh.ply') if (folder / n).is_file()), None)
    if mesh is not None:
        write_atomically(folder / THUMBNAIL, thumbnail(mesh))


def thumbnail(mesh: Path) -> bytes:
    """PNG of a mesh in the light, on a transparent ground."""
    from debris_scanner.sensing.rendering import MeshImages

    vertices, triangles = read_mesh(mesh)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    extent = 2 * float(np.linalg.norm(vertices - centre, axis=1).max())
    focal = 0.92 * _SIZE * _AWAY
    camera = Camera(focal, focal, _SIZE / 2 - 0.5, _SIZE / 2 - 0.5, _SIZE, _SIZE)
    R = exp_so3(np.array([_SEEN_FROM[0], 0, 0])) @ exp_so3(np.array([0, _SEEN_FROM[1], 0]))
    frame = MeshImages((vertices - centre) / extent, triangles).frame(
        camera, transform(R, np.array([0, 0, _AWAY]))
    )
    light = 0.35 + 0.65 * np.clip(frame.normals @ _LIGHT, 0, 1)
    image = np.zeros((_SIZE, _SIZE, 4), np.uint8)
    image[..., :3] = np.clip(light[..., None] * _COLOUR, 0, 255)
    image[..., 3] = np.where(frame.depth > 0, 255, 0)
    buffer = BytesIO()
    Image.fromarray(image).save(buffer, 'PNG')
    return buffer.getvalue()
