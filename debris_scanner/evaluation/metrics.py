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

"""Evaluation of a scan against the truth: the figures that ``debris-scan evaluate`` writes to metrics.json.

The estimate's target frame differs from the truth's. One constant alignment, the robust median over all
frames, is applied to poses, model and mesh alike, and no other. A symmetric target gets no more.
"""

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, apply
from debris_scanner.core.results import ClosureRecord, compared
from debris_scanner.evaluation.closure_scores import (
    BY_ATTITUDE,
    TRUE_POSE_RAD,
    TRUE_POSE_SHARE,
    closure_scores,
)
from debris_scanner.evaluation.trajectory_errors import (
    TRUE_CLOSURE_RAD,
    align,
    by_stamp,
    drift,
    pose_errors,
    turned,
    without_tilt,
)
from debris_scanner.evaluation.true_surface import TrueSurface
from debris_scanner.io.closure_records import read_closure_values
from debris_scanner.io.mesh_files import MeshFileError, read_cloud, read_mesh
from debris_scanner.io.result_files import ScanResult, complete
from debris_scanner.io.trajectories import TrajectoryFileError, read_tum
from debris_scanner.sim.surface import sample_mesh

RIGHT, WRONG = 'right', 'wrong'
PUBLISHED = ('model', 'tracked')  # results with a model: one of the scan's own, or one that was given

# Bounds within which a published model is right.
MAX_ATTITUDE_MEDIAN_DEG = 1.0
MAX_ATTITUDE_DEG = 5.0
MAX_MODEL_RMSE_MM = 2.0  # or, of a larger target,
MAX_MODEL_RMSE_SHARE = 0.005  # of its size

COMPLETE_WITHIN_M = 0.003  # a seen part this near to the model is complete
_MESH_SAMPLES = 50_000
_FULL_TURN_RAD = 2 * np.pi
_COMPARED_ATTITUDES = 24


Mesh = tuple[Array, NDArray[np.int32]]  # vertices (n, 3), triangles (m, 3)


class EvaluationError(ValueError):
    """A result or truth that is missing or cannot be read; the message names the file."""


@dataclass(frozen=True)
class Truth:
    """The true poses and surface of a target.

    Args:
        poses: T_sensor_target (4, 4) by stamp, integer nanoseconds; metres.
        surface: in the true target frame, metres: a mesh of trimesh, or a pair of vertices (n, 3) and
            triangles (m, 3).
        source: what it is called in messages.
    """

    poses: Mapping[int, Array]
    surface: Any
    source: str = 'the truth'

    @cached_property
    def true_surface(self) -> TrueSurface:
        """The surface, prepared for distances."""
        if isinstance(self.surface, TrueSurface):
            return self.surface
        mesh = self.surface
        vertices, triangles = mesh if isinstance(mesh, tuple | list) else (mesh.vertices, mesh.faces)
        return TrueSurface((np.asarray(vertices, np.float64), np.asarray(triangles, np.int32)))

    @staticmethod
    def read(folder: Path) -> 'Truth':
        """From ``truth.tum`` and ``truth_mesh.ply`` or ``truth_cloud.ply`` in a folder.

        Raises:
            EvaluationError: a file is missing or unreadable.
        """
        with _one_error():
            return Truth(by_stamp(read_tum(folder / 'truth.tum')), TrueSurface.read(folder), str(folder))


@dataclass(frozen=True)
class _Found:
    """What a scan found, from memory or from its files."""

    published: bool  # with a model
    poses: Mapping[int, Array]
    odometry: Mapping[int, Array]
    closures: list[ClosureRecord]
    keyframes_ns: list[int]
    model: Callable[[], tuple[Array, Mesh]]  # points and mesh of a published one
    names: tuple[str, str]  # of poses and odometry, for messages


def evaluate(
    result: ScanResult | Path | str,
    truth: Truth | Path | str,
    frames: Iterable[DepthFrame] | None = None,
) -> dict[str, Any]:
    """The figures of one scan, as metrics.json holds them; None where a figure does not apply.

    Args:
        result: of a scan, or the folder that ``scan`` or ``live`` wrote.
        truth: true poses and surface, or a folder with ``truth.tum`` and ``truth_mesh.ply`` or
            ``truth_cloud.ply``.
        frames: the recording's depth frames, to find which surface was seen; read once. None: all frames with
            a true pose show the target, and there is no completeness.

    Returns:
        ``attitude_deg``, ``position_mm``, ``model_mm``, ``mesh_mm``, ``completeness``, ``closures``,
        ``drift``, ``verdict`` and more, as ``debris-scan evaluate`` prints them.

    Raises:
        EvaluationError: a file is missing or unreadable, or no pose has a true one.
        OutputError: as of :func:`complete`.
    """
    if isinstance(result, ScanResult):
        found = _in_memory(result)
    else:
        complete(Path(result))
        with _one_error():
            found = _in_folder(Path(result))
    with _one_error():
        known = truth if isinstance(truth, Truth) else Truth.read(Path(truth))
        for name, poses in ((found.names[0], found.poses), (found.names[1], found.odometry)):
            _check_same_recording(name, poses, known)
        return _figures(found, known, frames)


def _in_memory(result: ScanResult) -> _Found:
    def surface() -> tuple[Array, Mesh]:
        model = result.model
        assert model is not None
        return model.points.astype(np.float64), (model.vertices.astype(np.float64), model.triangles)

    return _Found(
        bool(result),
        by_stamp(result.poses),
        by_stamp(result.odometry),
        result.closures,
        [pose.stamp_ns for pose in result.keyframe_poses],
        surface,
        ('the result', 'the odometry'),
    )


def _in_folder(folder: Path) -> _Found:
    def surface() -> tuple[Array, Mesh]:
        return read_cloud(folder / 'model.ply'), read_mesh(folder / 'mesh.ply')

    summary = _read_summary(folder / 'summary.json')
    published = summary['result'] in PUBLISHED
    poses, odometry = folder / 'target_pose.tum', folder / 'odometry.tum'
    return _Found(
        published,
        _read_poses(poses, needed=published),
        _read_poses(odometry, needed=False),
        _closures(summary),
        _keyframe_stamps(folder / 'graph.g2o'),
        surface,
        (str(poses), str(odometry)),
    )


@contextlib.contextmanager
def _one_error() -> Iterator[None]:
    """What cannot be read is an EvaluationError."""
    try:
        yield
    except (OSError, MeshFileError, TrajectoryFileError) as error:
        raise EvaluationError(str(error)) from error


def format_table(metrics: Mapping[str, Any]) -> str:
    """The figures as lines for a terminal."""
    lines = []
    for key, title in (
        ('attitude_deg', 'attitude error, deg'),
        ('position_mm', 'position error, mm'),
        ('model_mm', 'model error, mm'),
        ('mesh_mm', 'mesh error, mm'),
        ('closures', 'closures'),
        ('drift', 'drift at first closure'),
    ):
        figures = metrics[key] or {}
        text = '   '.join(f'{name} {_number(value)}' for name, value in figures.items())
        if key == 'closures':
            text += _closure_note(bool(figures.get('false')), metrics.get('closures_by'))
        lines.append(f'{title:24s}{text or "-"}')
    if metrics.get('tilt_deg') is not None:
        rest = metrics['attitude_untilted_deg']
        without = f'median {_number(rest["median"])}   max {_number(rest["max"])}'
        text = f'{_number(metrics["tilt_deg"])}   without it: {without}'
        lines.insert(1, f'{"  of it sensor tilt":24s}{text}')
    complete = _number(metrics['completeness'])
    of = '' if complete == '-' else '   of the surface that frames showed; the rest is not counted'
    lines.insert(-2, f'{"completeness":24s}{complete}{of}')
    return '\n'.join([*lines, f'{"verdict":24s}{metrics["verdict"]}: {metrics["why"]}'])


def _figures(found: _Found, truth: Truth, frames: Iterable[DepthFrame] | None) -> dict[str, Any]:
    poses, surface, estimate = truth.poses, truth.true_surface, found.poses
    in_sight = [
        poses[f.stamp_ns]
        for f in frames or ()
        if f.stamp_ns in poses and surface.observe(f, poses[f.stamp_ns])
    ]
    if frames is None:
        in_sight = [poses[stamp] for stamp in sorted(poses)]
    scores, judged_by = closure_scores(poses, found.closures, found.keyframes_ns, surface.size)
    metrics: dict[str, Any] = {
        'attitude_deg': None,
        'tilt_deg': None,
        'attitude_untilted_deg': None,
        'position_mm': None,
        'model_mm': None,
        'mesh_mm': None,
        'completeness': None,
        'closures': scores,
        'closures_by': judged_by,
        'drift': _drift(poses, found.odometry, found.closures),
    }
    compared = len(poses.keys() & estimate.keys())
    if compared > 1:
        T_truth_target = align(poses, estimate)
        attitude, position = pose_errors(poses, estimate, T_truth_target)
        metrics['attitude_deg'] = _spread(np.degrees(attitude), 'median', 'p95', 'max')
        metrics['position_mm'] = _spread(position * 1e3, 'median', 'p95', 'max')
        tilt, rest = without_tilt(poses, estimate)
        metrics['tilt_deg'] = round(float(np.degrees(tilt)), 4)
        metrics['attitude_untilted_deg'] = _spread(np.degrees(rest), 'median', 'p95', 'max')
        if found.published:
            metrics |= _surface_figures(found, surface, T_truth_target)
    metrics['verdict'], metrics['why'] = _verdict(found.published, metrics, surface, in_sight)
    return metrics


def _check_same_recording(name: str, poses: Mapping[int, Array], truth: Truth) -> None:
    """Check by the stamps that poses and truth are of one recording.

    A recording that was played several times has true poses only for the first time.
    """
    if not poses:
        return
    known = truth.poses
    within = [stamp for stamp in poses if min(known, default=0) <= stamp <= max(known, default=-1)]
    unknown = sum(stamp not in known for stamp in within)
    if unknown or not within:
        raise EvaluationError(
            f'{unknown or len(poses)} of {len(poses)} poses in {name} have no true one of their stamp: '
            f'{truth.source} is the truth of another recording'
        )


def _closure_note(false: bool, judged_by: str | None) -> str:
    """What the closures were judged by where it is not the pose, and when one is false."""
    said = ['by attitude'] if judged_by == BY_ATTITUDE else []
    if false and judged_by == BY_ATTITUDE:
        said.append(f'over {np.degrees(TRUE_CLOSURE_RAD):.0f} deg apart, if only rolled')
    elif false:
        said.append(f'over {np.degrees(TRUE_POSE_RAD):.0f} deg or {TRUE_POSE_SHARE:.0%} of the size off')
    return f'   ({": ".join(said)})' if said else ''


def _surface_figures(found: _Found, surface: TrueSurface, T_truth_target: Array) -> dict[str, Any]:
    """Errors of model and mesh, and completeness; None against an empty truth."""
    points, (vertices, triangles) = found.model()
    points = apply(T_truth_target, points)
    if surface.empty or len(points) == 0:
        return {}
    mesh = apply(T_truth_target, sample_mesh(vertices, triangles, _MESH_SAMPLES))
    seen = surface.seen()
    tree = scipy.spatial.cKDTree(points)
    near = tree.query(seen, distance_upper_bound=COMPLETE_WITHIN_M)[0] if len(seen) else np.zeros(0)
    return {
        'model_mm': _spread(surface.distance(points) * 1e3, 'median', 'rmse', 'p95'),
        'mesh_mm': _spread(surface.distance(mesh) * 1e3, 'median', 'rmse', 'p95'),
        'completeness': round(float(np.isfinite(near).mean()), 4) if len(seen) else None,
    }


def _verdict(
    published: bool, metrics: Mapping[str, Any], surface: TrueSurface, in_sight: list[Array]
) -> tuple[str, str]:
    """Right or wrong, and why in words."""
    if not published:
        reason = _impossible(surface, in_sight)
        return (
            (RIGHT, f'no model, and none could be had: {reason}') if reason else (WRONG, 'a model was missed')
        )
    attitude, model = metrics['attitude_deg'], metrics['model_mm']
    max_rmse = max(MAX_MODEL_RMSE_MM, MAX_MODEL_RMSE_SHARE * surface.size * 1e3)
    if attitude is None:
        return WRONG, 'one pose has a true one: its error is aligned away'
    if model is None:
        return WRONG, 'a model of nothing'
    beyond = [
        f'{name} {compared(value, "above", bound)} {unit}'
        for name, value, bound, unit in (
            ('attitude median', attitude['median'], MAX_ATTITUDE_MEDIAN_DEG, 'deg'),
            ('attitude max', attitude['max'], MAX_ATTITUDE_DEG, 'deg'),
            ('model rmse', model['rmse'], max_rmse, 'mm'),
        )
        if not value <= bound
    ]
    return (WRONG, ', '.join(beyond)) if beyond else (RIGHT, 'a model within bounds')


def _impossible(surface: TrueSurface, in_sight: list[Array]) -> str | None:
    """Why no model could have been made, or None if one could.

    Args:
        surface: the true one.
        in_sight: true T_sensor_target of the frames that show the target, in order.
    """
    if surface.empty:
        return 'the scene is empty'
    # slightly less than a turn counts: with few frames the last one lies one step before it
    if turned(in_sight) < 0.95 * _FULL_TURN_RAD:
        return 'less than a full turn was seen'
    some = np.array(in_sight[:: max(1, len(in_sight) // _COMPARED_ATTITUDES)])[:, :3, :3]
    if surface.looks_the_same(some[0].T @ some) or surface.is_body_of_revolution():
        return 'the rotation of a body of revolution cannot be observed'
    return None


def _drift(
    truth: Mapping[int, Array], odometry: Mapping[int, Array], closures: list[ClosureRecord]
) -> dict[str, float] | None:
    """Error of the odometry at the first accepted closure, degrees and millimetres."""
    accepted = [c.to_stamp_ns for c in closures if c.accepted]
    error = drift(truth, odometry, min(accepted)) if accepted else None
    return error and {'deg': round(float(np.degrees(error[0])), 4), 'mm': round(error[1] * 1e3, 4)}


def _spread(values: Array, *names: str) -> dict[str, float]:
    """Named statistics of errors (n,)."""
    every = {
        'median': np.median(values),
        'rmse': np.sqrt(np.mean(values**2)),
        'p95': np.percentile(values, 95),
        'max': values.max(),
    }
    return {name: round(float(every[name]), 4) for name in names}


def _read_poses(path: Path, needed: bool) -> dict[int, Array]:
    return by_stamp(read_tum(path)) if needed or path.is_file() else {}


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise EvaluationError(f'{path} is not JSON: {error}') from error
    if not isinstance(summary, dict) or summary.get('result') not in (*PUBLISHED, 'no_model'):
        raise EvaluationError(f'{path} says neither "model", "tracked" nor "no_model" under "result"')
    return summary


def _closures(summary: Mapping[str, Any]) -> list[ClosureRecord]:
    try:
        return [read_closure_values(c) for c in summary.get('closures', [])]
    except (KeyError, TypeError, ValueError) as error:
        raise EvaluationError(f'summary.json has a malformed closure: {error!r}') from error


def _keyframe_stamps(path: Path) -> list[int]:
    """Stamps of the key frames, from comments in the pose graph's file."""
    if not path.is_file():
        return []
    fields = [
        line.split() for line in path.read_text(encoding='utf-8').splitlines() if line.startswith('# vertex')
    ]
    return [int(f[4]) for f in fields if len(f) == 5 and f[4].isdecimal()]


def _number(value: float | None) -> str:
    if value is None:
        return '-'
    return str(value) if isinstance(value, int) else f'{value:.3f}'
