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

"""Reading back what a scan wrote into its folder.

Only summary.json is required; of all other files the report shows what it finds.
"""

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array, from_quaternion, transform
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.core.results import Checks, ClosureRecord, Forecast, StampedPose
from debris_scanner.core.turn import TurnWatch
from debris_scanner.io.closure_records import read_checks, read_closure_values
from debris_scanner.io.mesh_files import decimated, read_mesh
from debris_scanner.io.result_files import FORECAST, METRICS, PROBABILITIES, SUMMARY, complete
from debris_scanner.io.trajectories import read_tum
from debris_scanner.mapping.closure_matrices import ClosureMatrices

MOST_TRIANGLES, FEW_TRIANGLES = 30_000, 4_000  # on a page; where it is not the figure's subject
CLOSED = 'mesh_closed.ply'


class ScanOutputError(ValueError):
    """A folder that holds no scan's result, or a damaged one; the message names the file."""


@dataclass(frozen=True)
class Rates:
    """Rates that the filter estimated; arrays run over the frames."""

    stamps_ns: NDArray[np.int64]
    omega: Array  # (n, 3) rad/s, target frame
    sigma: Array  # (n, 3)
    accepted: NDArray[np.bool_]  # by the gate


@dataclass(frozen=True)
class KeyFrames:
    """Key frames as the pose graph left them, and its final edges."""

    stamps_ns: NDArray[np.int64]  # (n,)
    T_target_sensor: Array  # (n, 4, 4)
    edges: NDArray[np.int64]  # (m, 2), earlier and later; empty without a model

    @property
    def path_rad(self) -> Array:
        """Rotation travelled (n,) up to each, as the straight turns from one to the next."""
        R = self.T_target_sensor[:, :3, :3]
        cosine = (np.einsum('nij,nij->n', R[1:], R[:-1]) - 1) / 2
        return np.concatenate([np.zeros(min(len(R), 1)), np.cumsum(np.arccos(np.clip(cosine, -1, 1)))])


class Painted(NamedTuple):
    """A mesh, and which of its faces were seen."""

    vertices: Array  # (m, 3)
    triangles: NDArray[np.int32]  # (t, 3)
    observed: NDArray[np.bool_]  # (t,)


@dataclass(frozen=True)
class Surface:
    """The model's mesh, and its cloud with colours where the sensor had them; metres, target frame.

    The mesh is the closed one where the scan left it, else what was seen of it.
    """

    vertices: Array  # (m, 3)
    triangles: NDArray[np.int32]  # (t, 3)
    points: Array  # (n, 3)
    rgb: Array | None  # (n, 3), 0..1
    observed: NDArray[np.bool_] | None = None  # (t,); None unless the mesh is closed

    @cached_property
    def coarse(self) -> Painted:
        """The mesh as a page shows it: at most ``MOST_TRIANGLES`` triangles."""
        seen = np.ones(len(self.triangles), bool) if self.observed is None else self.observed
        return _thinned(Painted(self.vertices, self.triangles, seen), MOST_TRIANGLES)

    @cached_property
    def rough(self) -> Painted:
        """The mesh beside other things: at most ``FEW_TRIANGLES`` triangles."""
        return _thinned(self.coarse, FEW_TRIANGLES)


def _thinned(mesh: Painted, most: int) -> Painted:
    """Decimated; a face was seen if the nearest face of the mesh as given was."""
    vertices, triangles = decimated(mesh.vertices, mesh.triangles, most)
    if len(triangles) == len(mesh.triangles):
        return mesh
    if mesh.observed.all():
        return Painted(vertices, triangles, np.ones(len(triangles), bool))
    before, now = (v[t].mean(axis=1) for v, t in (mesh[:2], (vertices, triangles)))
    return Painted(vertices, triangles, mesh.observed[cKDTree(before).query(now)[1]])


@dataclass(frozen=True)
class ScanOutput:
    """Everything that a report shows; what the folder lacks is None or empty."""

    name: str
    summary: dict[str, Any]
    metrics: dict[str, Any] | None
    rates: Rates
    poses: list[StampedPose]
    odometry: list[StampedPose]
    keyframes: KeyFrames
    closures: list[ClosureRecord]
    matrices: ClosureMatrices | None
    surface: Surface | None
    forecast: Forecast | None
    checks: Checks = ()  # of the verdict

    @property
    def start_ns(self) -> int:
        """Stamp that the plots count seconds from: the first that is known."""
        known = [*self.rates.stamps_ns[:1], *self.keyframes.stamps_ns[:1]]
        known += [p.stamp_ns for p in (*self.poses[:1], *self.odometry[:1])]
        return int(min(known, default=0))

    def seconds(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Time since the start."""
        return np.asarray((stamps_ns - self.start_ns) * 1e-9)

    @cached_property
    def turn_shown(self) -> float | None:
        """Radians of the turn that was followed, live; None where no pose is known."""
        watch = TurnWatch()
        for pose in self.odometry or self.poses:
            watch.add('', pose.T_sensor_target[:3, :3])
        return watch.shown if self.odometry or self.poses else None

    @property
    def first_closure(self) -> ClosureRecord | None:
        """The accepted closure that came first."""
        accepted = [c for c in self.closures if c.accepted]
        return min(accepted, key=lambda c: c.to_stamp_ns, default=None)


def read_scan(directory: Path) -> ScanOutput:
    """What ``scan`` or ``live`` wrote into ``directory``.

    Raises:
        ScanOutputError: there is no summary, or a file is damaged.
        OutputError: as of :func:`complete`.
    """
    complete(directory)
    summary = _json(directory / SUMMARY)
    if summary is None:
        raise ScanOutputError(f'{directory} has no {SUMMARY}: not the result of a scan')
    try:
        return ScanOutput(
            name=directory.resolve().name,
            summary=summary,
            metrics=_json(directory / METRICS),
            rates=_rates(directory / 'rates.csv'),
            poses=_poses(directory / 'target_pose.tum'),
            odometry=_poses(directory / 'odometry.tum'),
            keyframes=_keyframes(directory / 'graph.g2o'),
            closures=[read_closure_values(c) for c in summary['closures']],
            matrices=_matrices(directory / PROBABILITIES),
            surface=_surface(directory) if summary['result'] == 'model' else None,
            forecast=_forecast(directory / FORECAST),
            checks=read_checks(summary.get('checks', ())),
        )
    except (ValueError, KeyError, TypeError, IndexError) as error:
        said = str(error) if isinstance(error, ValueError) else f'{SUMMARY} lacks or garbles {error}'
        raise ScanOutputError(said if str(directory) in said else f'{directory}: {said}') from error


def _json(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise ScanOutputError(f'{path} is not JSON: {error}') from error
    if not isinstance(content, dict):
        raise ScanOutputError(f'{path} holds no JSON object')
    return content


def _poses(path: Path) -> list[StampedPose]:
    return read_tum(path) if path.is_file() else []


def _matrices(path: Path) -> ClosureMatrices | None:
    return ClosureMatrices.read(path) if path.is_file() else None


def _rates(path: Path) -> Rates:
    rows: list[list[str]] = []
    if path.is_file():
        with path.open(newline='', encoding='utf-8') as file:
            rows = [row for row in csv.reader(file) if row][1:]
    if any(len(row) != 8 for row in rows):
        raise ScanOutputError(f'{path}: a row has not the 8 columns of rates')
    numbers = np.array([[float(x) for x in row[1:7]] for row in rows]).reshape(-1, 6)
    stamps = np.array([int(row[0]) for row in rows], dtype=np.int64)
    accepted = np.array([row[7] == 'accepted' for row in rows], dtype=bool)
    return Rates(stamps, numbers[:, :3], numbers[:, 3:], accepted)


def _forecast(path: Path) -> Forecast | None:
    if not path.is_file():
        return None
    with path.open(newline='', encoding='utf-8') as file:
        rows = [row for row in csv.reader(file) if row][1:]
    if not rows or any(len(row) != 20 for row in rows):
        raise ScanOutputError(f'{path}: a row has not the 20 columns of a forecast')
    v = np.array([[float(x) for x in row[1:]] for row in rows])
    poses = np.array([transform(from_quaternion(row[3:7]), row[:3]) for row in v])
    return Forecast([int(row[0]) for row in rows], poses, v[:, 7:10], v[:, 10:13], v[:, 13:16], v[:, 16:19])


def _keyframes(path: Path) -> KeyFrames:
    """Vertices, their stamps (in comments) and edges of the pose graph's file."""
    stamps: dict[int, int] = {}
    poses: dict[int, Array] = {}
    edges: list[tuple[int, int]] = []
    lines = path.read_text(encoding='utf-8').splitlines() if path.is_file() else []
    for line in lines:
        field = line.split()
        if line.startswith('# vertex '):
            stamps[int(field[2])] = int(field[4])
        elif line.startswith('VERTEX_SE3:QUAT '):
            v = np.array([float(x) for x in field[2:9]])
            poses[int(field[1])] = transform(from_quaternion(v[3:]), v[:3])
        elif line.startswith('EDGE_SE3:QUAT '):
            edges.append((int(field[1]), int(field[2])))
    order = sorted(poses)
    if order != list(range(len(order))) or any(k not in stamps for k in order):
        raise ScanOutputError(f'{path}: its vertices are not numbered or not stamped')
    if any(not 0 <= k < len(order) for edge in edges for k in edge):
        raise ScanOutputError(f'{path}: an edge names no vertex')
    return KeyFrames(
        np.array([stamps[k] for k in order], dtype=np.int64),
        np.array([poses[k] for k in order]).reshape(-1, 4, 4),
        np.array(edges, dtype=np.int64).reshape(-1, 2),
    )


def _surface(directory: Path) -> Surface | None:
    mesh, model = directory / 'mesh.ply', directory / 'model.ply'
    closed = directory / CLOSED
    if not model.is_file() or not (mesh.is_file() or closed.is_file()):
        return None
    observed = None
    if closed.is_file():
        vertices, triangles, observed = _closed(closed)
    else:
        vertices, triangles = read_mesh(mesh)
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(str(model))
    points = np.asarray(cloud.points, np.float64)
    if len(points) == 0:
        raise ScanOutputError(f'{model} holds no points')
    rgb = np.asarray(cloud.colors) if cloud.has_colors() else None
    return Surface(vertices, triangles, points, rgb, observed)


def _closed(path: Path) -> Painted:
    """The closed mesh as `io.model_files.closed_ply` writes it; Open3D would drop what was observed."""
    head, end, body = path.read_bytes().partition(b'end_header\n')
    lines = [line.split() for line in head.decode('ascii', 'replace').splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line[:1] == ['element']}
    kinds = {'float': '<f4', 'uchar': 'u1'}
    columns = [(line[2], kinds[line[1]]) for line in lines if line[:1] == ['property'] and line[1] in kinds]
    face = np.dtype([('count', 'u1'), ('index', '<i4', 3), ('observed', 'u1')])
    if not end or columns[-1:] != [('observed', 'u1')] or list(counts) != ['vertex', 'face']:
        raise ScanOutputError(f'{path} is not a closed mesh whose faces are observed or not')
    vertex = np.dtype(columns[:-1])
    if len(body) != counts['vertex'] * vertex.itemsize + counts['face'] * face.itemsize:
        raise ScanOutputError(f'{path} is cut short')
    rows = np.frombuffer(body, vertex, counts['vertex'])
    faces = np.frombuffer(body, face, counts['face'], counts['vertex'] * vertex.itemsize)
    index = faces['index'].astype(np.int32)
    vertices = np.stack([rows[axis] for axis in 'xyz'], axis=1).astype(np.float64)
    if not len(index) or index.min() < 0 or index.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise ScanOutputError(f'{path} has broken vertices or indices')
    return Painted(vertices, index, faces['observed'] > 0)
