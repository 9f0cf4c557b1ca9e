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

"""Reading a model that is known beforehand: an earlier scan's output folder, or any mesh in metres."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import vertex_normals
from debris_scanner.core.voxel_grid import voxel_grid_with_normals
from debris_scanner.io.mesh_exports import is_in_millimetres
from debris_scanner.io.mesh_files import Colours, MeshFileError, proper_triangles, read_coloured_mesh
from debris_scanner.io.result_files import SUMMARY, ScanResult, complete, tells_of_model

DRAWN = 200_000  # points of a mesh, before they are thinned
SPACING = 1 / 200  # of the extent, between those that stay
SHARP_COS = 0.9  # a corner's normal further from a triangle's is of a real edge
LARGEST, SMALLEST = (
    20.0,
    0.01,
)  # m: targets are looked for up to so far away; a model beyond is in another unit


def read_known_model(path: Path) -> Model:
    """The model of a scan's output folder, or of a mesh file in metres, in its own frame, with its colours.

    An STL of our own is in millimetres, and says so.

    Raises:
        MeshFileError: there is no model, or its size cannot be in metres; the message names the file.
        OutputError: the scan that wrote the folder was killed meanwhile, and it cannot be put in order.
    """
    folder = path.is_dir()
    file = path / 'mesh.ply' if folder else path
    if folder:
        complete(path)
        _check_result(path)
    vertices, triangles, rgb = read_coloured_mesh(file)
    if is_in_millimetres(file):
        vertices = vertices * 0.001
    try:
        model = _of_mesh(vertices, triangles, rgb)
    except ValueError as error:
        raise MeshFileError(f'{file} {error}') from None
    closed_file = path / 'mesh_closed.ply'
    if folder and closed_file.is_file():
        model = replace(model, closed=_read_closed(closed_file))
    return model


def as_known_model(given: Any) -> Model:
    """The model in any of the forms in which a program has one.

    Args:
        given: a model, the result or the folder of a scan, a mesh file, or a mesh of trimesh (``vertices``,
            ``faces``) or Open3D (``vertices``, ``triangles``), metres.

    Raises:
        ValueError: it is none of these, has no model, or its size cannot be in metres.
        MeshFileError: a file cannot be read.
    """
    if isinstance(given, Model):
        return given
    if isinstance(given, ScanResult):
        if given.model is None:
            raise ValueError(f'the scan has no model to track: {given.reason}')
        return given.model
    if isinstance(given, str | Path):
        return read_known_model(Path(given))
    vertices, faces = getattr(given, 'vertices', None), getattr(given, 'faces', None)
    faces = getattr(given, 'triangles', None) if faces is None else faces
    if vertices is None or faces is None:
        raise ValueError(f'a model is a Model, a ScanResult, a path or a mesh, not {type(given).__name__}')
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int32)
    try:
        return _of_mesh(vertices, proper_triangles(vertices, faces), None)
    except ValueError as error:
        raise ValueError(f'the mesh {error}') from None


def _of_mesh(vertices: NDArray[np.floating], triangles: NDArray[np.int32], rgb: Colours) -> Model:
    """A model with the surface of a mesh, metres.

    Raises:
        ValueError: its size cannot be in metres; the message lacks a subject.
    """
    extent = float(np.ptp(vertices, axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        unit = 'another unit' if extent < SMALLEST else 'millimetres'
        raise ValueError(f'is {extent:.3g} m large: is it in {unit}? A model must be in metres')
    points, normals, point_rgb = _evenly(vertices, triangles, SPACING * extent, rgb)
    return Model(points, normals, vertices.astype(np.float32), triangles, point_rgb, rgb)


def _check_result(path: Path) -> None:
    """Check that a folder has the whole result of a scan with a model: its summary says so."""
    told = tells_of_model(path)
    if told is None:
        why = f'it has no {SUMMARY} of a finished scan (a mesh that is whole can be given by its name)'
    elif not told:
        why = 'that scan ended without one'
    elif not (path / 'mesh.ply').is_file():
        why = 'it has no mesh.ply'
    else:
        return
    raise MeshFileError(f'no model in {path}: {why}')


def _evenly(
    vertices: NDArray[np.floating], triangles: NDArray[np.int32], spacing: float, rgb: Colours
) -> tuple[NDArray[np.float32], NDArray[np.float32], Colours]:
    """Points (n, 3) spread over a mesh, some ``spacing`` apart, with smooth normals and colours (n, 3)."""
    corners = vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face, axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(triangles), DRAWN, p=area / area.sum())
    root, along = np.sqrt(rng.random(DRAWN)), rng.random(DRAWN)
    weight = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    points = np.einsum('ij,ijk->ik', weight, corners[chosen])
    flat = face[chosen] / area[chosen, None]
    at_corners = vertex_normals(vertices, triangles)[triangles[chosen]]
    smooth = np.einsum('ij,ijk->ik', weight, at_corners)
    sharp = np.einsum('ijk,ik->ij', at_corners, flat).min(axis=1) < SHARP_COS
    normals = np.where(sharp[:, None], flat, smooth)
    thinned, unit = voxel_grid_with_normals(points.astype(np.float32), normals.astype(np.float32), spacing)
    if rgb is None:
        return thinned, unit, None
    near = scipy.spatial.cKDTree(points).query(thinned)[1]
    mixed = np.einsum('ij,ijk->ik', weight[near], rgb[triangles[chosen[near]]].astype(np.float64))
    return thinned, unit, np.rint(mixed).astype(np.uint8)


def _read_closed(file: Path) -> ClosedMesh:
    import trimesh  # late: few scans begin with a model

    mesh = trimesh.load(file, process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshFileError(f'not a closed mesh of a scan: {file}')
    try:
        observed = np.asarray(mesh.metadata['_ply_raw']['face']['data']['observed']).ravel() > 0
    except (KeyError, ValueError) as error:
        raise MeshFileError(f'the faces have no property "observed": {file}') from error
    rgb = read_coloured_mesh(file)[2]
    return ClosedMesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), observed, rgb)
