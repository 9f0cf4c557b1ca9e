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

"""Mesh and cloud files: reading OBJ, STL and PLY, and writing PLY. Open3D reads all but OBJ."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.files import write_atomically

SUFFIXES = ('.obj', '.stl', '.ply')  # of mesh files


class MeshFileError(ValueError):
    """A mesh file that is missing or holds no usable triangles; the message names the file."""


Colours = NDArray[np.uint8] | None


def read_mesh(path: Path, allow_empty: bool = False) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and triangles as :func:`read_coloured_mesh`, without the colours."""
    return read_coloured_mesh(path, allow_empty)[:2]


def read_coloured_mesh(path: Path, allow_empty: bool = False) -> tuple[Array, NDArray[np.int32], Colours]:
    """Vertices (n, 3) in the file's unit, triangles (t, 3) as the file orders them, and colours (n, 3).

    The colours are those of the vertices, None if the file has none.

    Raises:
        MeshFileError: the file is missing, unreadable, or without triangles unless those are allowed.
    """
    if not path.is_file():
        raise MeshFileError(f'mesh file not found: {path}')
    if path.suffix.lower() == '.obj':
        vertices, triangles, rgb = _read_obj(path)
    else:
        o3d = load_open3d()
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            mesh = o3d.io.read_triangle_mesh(str(path))
        vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles, np.int32)
        rgb = _bytes(np.asarray(mesh.vertex_colors)) if mesh.has_vertex_colors() else None
    if len(triangles) == 0 and allow_empty:
        return vertices, triangles.reshape(0, 3), rgb
    try:
        return vertices, proper_triangles(vertices, triangles), rgb
    except ValueError as error:
        raise MeshFileError(f'{path} {error}') from None


def proper_triangles(vertices: Array, triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """The triangles (t, 3) that have an area.

    Raises:
        ValueError: there are none, or what they are made of is no vertex (n, 3); the message lacks a subject.
    """
    if len(triangles) == 0:
        raise ValueError('has no triangles')
    if (vertices.shape[1:], triangles.shape[1:]) != ((3,), (3,)):
        raise ValueError(f'has vertices {vertices.shape}, triangles {triangles.shape}: not (n, 3), (t, 3)')
    if triangles.min() < 0 or triangles.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise ValueError('has broken vertices or indices')
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.any():
        raise ValueError('has degenerate triangles alone')
    return triangles[area > 0]


def read_cloud(path: Path) -> Array:
    """Points (n, 3) of a PLY file, float64.

    Raises:
        FileNotFoundError: there is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f'cloud not found: {path}')
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        return np.asarray(o3d.io.read_point_cloud(str(path)).points, np.float64)


def write_mesh_ply(path: Path, vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> None:
    """Write a binary PLY, atomically: vertices (n, 3) float32, triangles (t, 3)."""
    faces = np.empty(len(triangles), np.dtype([('count', 'u1'), ('index', '<i4', 3)]))
    faces['count'], faces['index'] = 3, triangles
    header = (
        'ply\nformat binary_little_endian 1.0\n'
        f'element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n'
        f'element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n'
    )
    write_atomically(path, header.encode() + np.asarray(vertices, '<f4').tobytes() + faces.tobytes())


def _bytes(colours: Array) -> NDArray[np.uint8]:
    """Colours (n, 3) of 0 to 1 as bytes."""
    return np.clip(np.rint(255 * colours), 0, 255).astype(np.uint8)


def _read_obj(path: Path) -> tuple[Array, NDArray[np.int32], Colours]:
    """Geometry of an OBJ file, and colours behind the coordinates, of 0 to 1.

    Open3D rejects a file whose materials are missing; trimesh takes a surface apart where they meet.
    """
    vertices: list[list[float]] = []
    colours: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    try:
        with path.open(encoding='utf-8', errors='replace') as lines:
            for line in lines:
                word, *rest = line.split() or ['']
                if word == 'v':
                    vertices.append([float(x) for x in rest[:3]])
                    if len(rest) >= 6:
                        colours.append([float(x) for x in rest[3:6]])
                elif word == 'f':
                    index = [int(corner.split('/')[0]) for corner in rest]
                    index = [i - 1 if i > 0 else len(vertices) + i for i in index]
                    triangles += [(index[0], b, c) for b, c in pairwise(index[1:])]
        rgb = _bytes(np.array(colours)) if colours and len(colours) == len(vertices) else None
        points = np.array(vertices, np.float64).reshape(-1, 3)
        return points, np.array(triangles, np.int32).reshape(-1, 3), rgb
    except ValueError as error:
        raise MeshFileError(f'not an OBJ file: {path} ({error})') from error


def decimated(vertices: Array, triangles: NDArray[np.int32], most: int) -> tuple[Array, NDArray[np.int32]]:
    """A mesh of at most ``most`` triangles, or as given if it has no more: quadric decimation."""
    if len(triangles) <= most:
        return vertices, triangles
    o3d = load_open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    few = mesh.simplify_quadric_decimation(most)
    return np.asarray(few.vertices), np.asarray(few.triangles, np.int32)[:most]
