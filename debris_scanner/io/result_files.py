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

"""Writing the results of a scan into its output folder: the files that users and scripts read.

All files are written aside and replace those of the earlier result together: on a full disk, or when the
process is killed, the old result is whole or the new one. The summary and what else is small is written
first, so that there is room for the verdict. Where summary.json exists, all other files belong to it. The
same scan gives the same bytes, except for times and memory in summary.json.
"""

import contextlib
import importlib.metadata
import json
import math
import platform
import resource
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from debris_scanner import __version__
from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, to_quaternion
from debris_scanner.core.results import (
    Checks,
    ClosureRecord,
    Descriptions,
    Forecast,
    GraphEdge,
    RateSample,
    StampedPose,
)
from debris_scanner.io.closure_records import closure_values
from debris_scanner.io.files import (
    SAVED,
    FolderInUse,
    claimed,
    put_in_place,
    write_atomically,
    written_together,
)
from debris_scanner.io.mesh_exports import CLOSED_FILES, TEXTURE_FILES
from debris_scanner.io.model_files import cloud_pcd, cloud_ply, mesh_ply, mesh_vtk
from debris_scanner.io.trajectories import write_g2o, write_tum
from debris_scanner.mapping.closure_matrices import ClosureMatrices
from debris_scanner.modelling.solid import coverage, solid

SUMMARY = 'summary.json'
METRICS = 'metrics.json'  # written by evaluate
REPORT = 'report.html'  # written by report
PICTURE = 'model.png'  # written by demo
NOT_MEASURED = 'not_measured'  # too few poses to tell the motion
FORECAST = 'forecast.csv'
PROBABILITIES = 'closure_probabilities.npz'
NO_MODEL = 'no_model'  # folder, inside the output folder, of a scan that must not replace a model
MODEL_FILES = {'model.pcd': cloud_pcd, 'model.ply': cloud_ply, 'mesh.ply': mesh_ply, 'mesh.vtk': mesh_vtk}
_OF_A_MODEL = (*MODEL_FILES, *CLOSED_FILES, *TEXTURE_FILES)
_POSES, _ODOMETRY, _RATES, _GRAPH = 'target_pose.tum', 'odometry.tum', 'rates.csv', 'graph.g2o'
_POSED = (_POSES, _ODOMETRY, _RATES, FORECAST, _GRAPH)
_ALL = (SUMMARY, METRICS, REPORT, PICTURE, *_POSED, PROBABILITIES, *_OF_A_MODEL)
_WAIT_S = 0.05  # between two looks at a result that is being put in place
_writing = threading.RLock()  # claims of one process do not exclude each other
# Libraries whose release can change a result; Open3D comes under either of two names.
LIBRARIES = ('numpy', 'scipy', 'networkx', 'numba', 'open3d', 'open3d-cpu', 'scikit-image')


@dataclass
class ScanResult:
    """Everything that a finished scan found; false without a model: ``reason`` then says why."""

    reason: str | None  # why there is no model, as in summary.json
    model: Model | None
    tracked: bool = False  # the model was given
    merged: list[Array] | None = None  # T_first_scan (4, 4) of the scans that became this model
    poses: list[StampedPose] = field(default_factory=list)  # final: optimised, then tracked
    odometry: list[StampedPose] = field(default_factory=list)  # before any loop closure
    rates: list[RateSample] = field(default_factory=list)
    keyframe_poses: list[StampedPose] = field(default_factory=list)  # optimised
    edges: list[GraphEdge] = field(default_factory=list)  # indices into keyframe_poses
    closures: list[ClosureRecord] = field(default_factory=list)
    frames_read: int = 0
    frames_rejected: dict[str, int] = field(default_factory=dict)
    errors: dict[str, int] = field(default_factory=dict)  # exceptions that were contained, by type
    sensor: dict[str, Any] | None = None  # its measured noise; None without neighbouring views
    rotation_period_s: float | None = None
    rotation_axis_sensor: Array | None = None  # (3,) unit
    symmetry: int | None = None
    model_disagreement: dict[str, Any] | None = None  # of a given model, where it lies most beside the target
    mass_properties: dict[str, Any] | None = None  # what the motion tells of them; None of too few poses
    forecast: Forecast | None = None  # of a target with a model whose motion was measured
    timing: dict[str, dict[str, float]] = field(default_factory=dict)  # stage: count, p50_ms, p99_ms
    descriptions: Descriptions | None = None  # of the key frames; None before several processes end
    hint: str = ''  # what is odd about the input of which most frames were of no use
    why: str = ''  # the same in words, or what speaks for the model
    checks: Checks = ()  # of the verdict
    wall_s: float = 0.0  # how long the scan took

    def __bool__(self) -> bool:
        """Whether there is a model."""
        return self.model is not None

    def save(self, folder: Path | str) -> Path:
        """Write all files of the scan, as ``debris-scan scan`` does; see :func:`write_results`.

        Args:
            folder: made if missing.

        Returns:
            The folder that has the files: not ``folder`` where that has the model of another scan and this
            one has none.

        Raises:
            OutputError: the folder or a file cannot be written.
        """
        return write_results(Path(folder), self, self.wall_s)


class OutputError(Exception):
    """An output folder or file that cannot be written; the message names it."""


def check_output_dir(path: Path) -> None:
    """Make the output folder, with parents, and check that files can be created there.

    Meant for the start of a scan, so that nobody scans for an hour into a read-only folder.

    Raises:
        OutputError: if the folder cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except (FileExistsError, NotADirectoryError) as error:
        raise OutputError(f'cannot write to output folder {path}: a file is in the way') from error
    except OSError as error:
        raise OutputError(f'cannot write to output folder {path}: {error.strerror or error}') from error


@contextlib.contextmanager
def claim(path: Path) -> Iterator[int]:
    """Have an output folder for this process alone, made if missing; what a killed scan left is put in order.

    Yields:
        The descriptor of the lock, for children to inherit: see :func:`claimed`.

    Raises:
        OutputError: the folder cannot be made or written to, or another process has it.
    """
    check_output_dir(path)
    with contextlib.ExitStack() as stack:
        try:
            descriptor = stack.enter_context(claimed(path))
            with _writing:
                put_in_place(path, SUMMARY)
        except FolderInUse as error:
            raise OutputError(f'{error}: wait for it, end it, or give another folder') from None
        except OSError as error:
            raise OutputError(f'cannot write to output folder {path}: {error.strerror or error}') from error
        yield descriptor


def complete(path: Path) -> None:
    """Put a result in place that a killed scan had written whole; whoever reads a folder calls this first.

    Raises:
        OutputError: it is not all in place, and the folder cannot be written to.
    """
    while (path / SAVED).is_dir():
        try:
            with _writing, claimed(path):
                put_in_place(path, SUMMARY)
        except FolderInUse:  # by the scan that is putting it in place
            time.sleep(_WAIT_S)
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(f'the result in {path} is whole, but not all in place: {reason}') from error


def holds_model(path: Path) -> bool:
    """Whether there is any file of a model, or a summary of one: a scan without one must not replace it."""
    return tells_of_model(path) or any((path / name).exists() for name in _OF_A_MODEL)


def tells_of_model(path: Path) -> bool | None:
    """Whether the result in a folder has a model, as its summary says; None: there is no whole result."""
    try:
        return json.loads((path / SUMMARY).read_bytes())['model'] is not None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def left_alone(path: Path, written: Path) -> str:
    """Why a result was written elsewhere than into ``path``; empty if it was not."""
    return '' if written == path else f'{path} holds the model of another scan and is left as it is'


def summaries(path: Path) -> dict[Path, int]:
    """The folders in which a scan into ``path`` may have saved, and the time of each one's summary, ns."""
    found = {}
    for folder in (path, path / NO_MODEL):
        with contextlib.suppress(OSError):
            found[folder] = (folder / SUMMARY).stat().st_mtime_ns
    return found


def newest_since(path: Path, before: Mapping[Path, int]) -> Path | None:
    """The folder of the last result that was saved into ``path`` since :func:`summaries` told of others."""
    new = {folder: t for folder, t in summaries(path).items() if before.get(folder) != t}
    return max(new, key=lambda folder: new[folder], default=None)


def write_results(directory: Path, result: ScanResult, wall_s: float, owned: bool = False) -> Path:
    """Write all files of a finished scan, in place of those of an earlier one.

    A scan without a model leaves a model that is there as it is: its files go into :data:`NO_MODEL`.

    Args:
        directory: output folder; made if missing.
        result: what the scan found.
        wall_s: how long the scan took, seconds.
        owned: the model that is there is of this scan, which has given it up.

    Returns:
        The folder that has the files.

    Raises:
        OutputError: the folder or a file cannot be written; the earlier result is then still there.
    """
    with _writing, claim(directory):
        if result.model is None and not owned and holds_model(directory):
            return write_results(directory / NO_MODEL, result, wall_s)
        try:
            with written_together(directory, _ALL) as folder:
                _write(folder, result, wall_s)
        except OSError as error:
            told = f'cannot write to {directory}: {error.strerror or error}'
            if (directory / SAVED).is_dir():
                told += '; the new result is whole and is put in place when it is next read'
            elif (directory / SUMMARY).is_file():
                told += '; the earlier result there is as it was'
            raise OutputError(told) from error
    return directory


def _write(folder: Path, result: ScanResult, wall_s: float) -> None:
    """Write all files of a result into an empty folder, the small ones first."""
    content = json.dumps(_finite(summary(result, wall_s)), indent=2, allow_nan=False)
    write_atomically(folder / SUMMARY, (content + '\n').encode())
    write_tum(folder / _POSES, result.poses)
    write_tum(folder / _ODOMETRY, result.odometry)
    write_atomically(folder / _RATES, _rates_csv(result.rates))
    if result.forecast is not None:
        write_atomically(folder / FORECAST, _forecast_csv(result.forecast))
    write_g2o(folder / _GRAPH, result.keyframe_poses, result.edges)
    if result.descriptions is not None:
        write_atomically(folder / PROBABILITIES, ClosureMatrices.of(result.descriptions).encode())
    if result.model is None:
        return
    for name, encode in MODEL_FILES.items():
        write_atomically(folder / name, encode(result.model))
    if (closed := result.model.closed) is None:
        return
    for name, encode_closed in CLOSED_FILES.items():
        write_atomically(folder / name, encode_closed(closed))
    if closed.texture is not None:
        for name, encode_texture in TEXTURE_FILES.items():
            write_atomically(folder / name, encode_texture(closed.texture))


def summary(result: ScanResult, wall_s: float) -> dict[str, Any]:
    """Content of summary.json; a frame that was read and not rejected counts as used."""
    axis = result.rotation_axis_sensor
    return {
        'result': 'no_model' if result.model is None else 'tracked' if result.tracked else 'model',
        'reason': result.reason,
        'checks': [check._asdict() for check in result.checks],
        **({'hint': result.hint} if result.hint else {}),
        'frames': {
            'read': result.frames_read,
            'used': result.frames_read - sum(result.frames_rejected.values()),
            'rejected': dict(sorted(result.frames_rejected.items())),
        },
        'keyframes': len(result.keyframe_poses),
        'closures': [closure_values(closure) for closure in result.closures],
        'rotation_period_s': result.rotation_period_s,
        'rotation_axis_sensor': None if axis is None else axis.tolist(),
        'symmetry': result.symmetry,
        'sensor': result.sensor,
        'model': None if result.model is None else _model_size(result.model),
        **({} if result.model_disagreement is None else {'model_disagreement': result.model_disagreement}),
        'coverage': None if result.model is None else coverage(result.model),
        'mass_properties': _mass_properties(result),
        **({} if result.merged is None else {'merged': [{'T_first_scan': _tum(T)} for T in result.merged]}),
        'errors': dict(sorted(result.errors.items())),
        'timing': result.timing,
        'wall_s': round(wall_s, 3),
        'peak_rss_mb': round(_peak_rss_mb(), 1),
        'versions': _versions(),
    }


def _tum(T: Array) -> list[float]:
    """Tx ty tz qx qy qz qw of a pose (4, 4)."""
    return [*T[:3, 3].tolist(), *to_quaternion(T[:3, :3]).tolist()]


def _model_size(model: Model) -> dict[str, int]:
    return {'points': len(model.points), 'triangles': len(model.triangles)}


def _mass_properties(result: ScanResult) -> dict[str, Any] | None:
    """What the motion tells, and beside it what the closed mesh would have at uniform density."""
    told = result.mass_properties
    if result.model is None or result.model.closed is None:
        return told
    of_mesh = solid(result.model.closed).told(told)
    return (told or {'observable': False, 'why': NOT_MEASURED}) | {'uniform_density': of_mesh}


def _rates_csv(rates: list[RateSample]) -> bytes:
    header = ['stamp_ns']
    header += [f'{name}_{axis}_rad_s' for name in ('omega', 'sigma') for axis in 'xyz']
    lines = [','.join([*header, 'gate'])]
    for rate in rates:
        numbers = [f'{v:.9g}' for v in (*rate.omega.tolist(), *rate.sigma.tolist())]
        lines.append(','.join([str(rate.stamp_ns), *numbers, 'accepted' if rate.accepted else 'rejected']))
    return ('\n'.join(lines) + '\n').encode()


def _forecast_csv(forecast: Forecast) -> bytes:
    header = ['stamp_ns', *(f't{axis}' for axis in 'xyz'), *(f'q{axis}' for axis in 'xyzw')]
    header += [f'omega_{axis}_rad_s' for axis in 'xyz']
    for name, unit in (('position', 'm'), ('attitude', 'rad'), ('omega', 'rad_s')):
        header += [f'sigma_{name}_{axis}_{unit}' for axis in 'xyz']
    lines = [','.join(header)]
    for n, (stamp_ns, T) in enumerate(zip(forecast.stamps_ns, forecast.poses, strict=True)):
        numbers = [*T[:3, 3], *to_quaternion(T[:3, :3]), *forecast.rates[n], *forecast.position_sigma[n]]
        numbers += [*forecast.attitude_sigma[n], *forecast.rate_sigma[n]]
        lines.append(','.join([str(stamp_ns), *(f'{v:.9g}' for v in numbers)]))
    return ('\n'.join(lines) + '\n').encode()


def _peak_rss_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == 'darwin' else 1e3)  # bytes there, kilobytes here


def _versions() -> dict[str, str]:
    versions = {'debris_scanner': __version__, 'python': platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name.removesuffix('-cpu')] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def _finite(value: Any) -> Any:
    """The same with null for numbers that JSON cannot hold, and plain numbers for numpy's."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    if hasattr(value, 'item'):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
