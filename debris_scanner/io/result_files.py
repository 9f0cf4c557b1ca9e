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

Every file is written under a temporary name and renamed, so it is complete or absent. The folder's old
summary is removed first and the new one written last: where summary.json exists, all other files belong to
it. The same scan gives the same bytes, except for times and memory in summary.json.
"""

import importlib.metadata
import json
import math
import os
import platform
import resource
import sys
from pathlib import Path
from typing import Any

from debris_scanner import __version__
from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, to_quaternion
from debris_scanner.core.results import Forecast, RateSample, ScanResult
from debris_scanner.io.closure_records import closure_values
from debris_scanner.io.files import write_atomically
from debris_scanner.io.mesh_exports import CLOSED_FILES, TEXTURE_FILES
from debris_scanner.io.model_files import cloud_pcd, cloud_ply, mesh_ply, mesh_vtk
from debris_scanner.io.trajectories import write_g2o, write_tum
from debris_scanner.mapping.closure_matrices import ClosureMatrices
from debris_scanner.modelling.coverage import coverage
from debris_scanner.modelling.solid import solid

SUMMARY = 'summary.json'
METRICS = 'metrics.json'  # written by evaluate
REPORT = 'report.html'  # written by report
NOT_MEASURED = 'not_measured'  # too few poses to tell the motion
FORECAST = 'forecast.csv'
PROBABILITIES = 'closure_probabilities.npz'
MODEL_FILES = {'model.pcd': cloud_pcd, 'model.ply': cloud_ply, 'mesh.ply': mesh_ply, 'mesh.vtk': mesh_vtk}
# Libraries whose release can change a result; Open3D comes under either of two names.
LIBRARIES = ('numpy', 'scipy', 'networkx', 'numba', 'open3d', 'open3d-cpu', 'scikit-image')


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
        probe = path / f'.writable.{os.getpid()}'
        probe.write_bytes(b'')
        probe.unlink()
    except (FileExistsError, NotADirectoryError) as error:
        raise OutputError(f'cannot write to output folder {path}: a file is in the way') from error
    except OSError as error:
        raise OutputError(f'cannot write to output folder {path}: {error.strerror or error}') from error


def holds_model(path: Path) -> bool:
    """Whether the folder has the result of a scan with a model, as its summary says."""
    try:
        content = json.loads((path / SUMMARY).read_bytes())
    except (OSError, ValueError):  # no summary, or no JSON: no complete result
        return False
    return isinstance(content, dict) and content.get('model') is not None


def write_results(directory: Path, result: ScanResult, wall_s: float) -> None:
    """Write all files of a finished scan; without a model those of an earlier scan's model are removed.

    Args:
        directory: output folder; made if missing.
        result: what the scan found.
        wall_s: how long the scan took, seconds.

    Raises:
        OutputError: if the folder or a file cannot be written.
    """
    check_output_dir(directory)
    content = json.dumps(_finite(summary(result, wall_s)), indent=2, allow_nan=False)
    try:
        (directory / SUMMARY).unlink(missing_ok=True)
        for name in (METRICS, REPORT):  # they belong to the earlier scan
            (directory / name).unlink(missing_ok=True)
        for name, encode in MODEL_FILES.items():
            if result.model is None:
                (directory / name).unlink(missing_ok=True)
            else:
                write_atomically(directory / name, encode(result.model))
        closed = None if result.model is None else result.model.closed
        for name, encode_closed in CLOSED_FILES.items():
            if closed is None:
                (directory / name).unlink(missing_ok=True)
            else:
                write_atomically(directory / name, encode_closed(closed))
        texture = None if closed is None else closed.texture
        for name, encode_texture in TEXTURE_FILES.items():
            if texture is None:
                (directory / name).unlink(missing_ok=True)
            else:
                write_atomically(directory / name, encode_texture(texture))
        write_tum(directory / 'target_pose.tum', result.poses)
        write_tum(directory / 'odometry.tum', result.odometry)
        write_atomically(directory / 'rates.csv', _rates_csv(result.rates))
        if result.forecast is None:
            (directory / FORECAST).unlink(missing_ok=True)
        else:
            write_atomically(directory / FORECAST, _forecast_csv(result.forecast))
        write_g2o(directory / 'graph.g2o', result.keyframe_poses, result.edges)
        if result.descriptions is None:
            (directory / PROBABILITIES).unlink(missing_ok=True)
        else:
            matrices = ClosureMatrices.of(result.descriptions)
            write_atomically(directory / PROBABILITIES, matrices.encode())
        write_atomically(directory / SUMMARY, (content + '\n').encode())
    except OSError as error:
        raise OutputError(f'cannot write {error.filename or directory}: {error.strerror or error}') from error


def summary(result: ScanResult, wall_s: float) -> dict[str, Any]:
    """Content of summary.json; a frame that was read and not rejected counts as used."""
    axis = result.rotation_axis_sensor
    return {
        'result': 'no_model' if result.model is None else 'tracked' if result.tracked else 'model',
        'reason': result.reason,
        **({'hint': result.hint} if result.hint else {}),
        'frames': {
            'read': result.frames_read,
            'used': result.frames_read - sum(result.frames_rejected.values()),
            'rejected': dict(sorted(result.frames_rejected.items())),
        },
        'errors': dict(sorted(result.errors.items())),
        'keyframes': len(result.keyframe_poses),
        'closures': [closure_values(closure) for closure in result.closures],
        'rotation_period_s': result.rotation_period_s,
        'rotation_axis_sensor': None if axis is None else axis.tolist(),
        'symmetry': result.symmetry,
        'sensor': result.sensor,
        'model': None if result.model is None else _model_size(result.model),
        'coverage': None if result.model is None else coverage(result.model),
        'mass_properties': _mass_properties(result),
        **({} if result.merged is None else {'merged': [{'T_first_scan': _tum(T)} for T in result.merged]}),
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
