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

"""Encoding a model as PCD, PLY and VTK: the same model gives the same bytes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import vertex_normals

_AXES = ('x', 'y', 'z')


def cloud_pcd(model: Model) -> bytes:
    """Binary PCD 0.7 of the model's points, colour first (PCL's XYZRGBA) where there is one, and normals."""
    columns: list[tuple[str, str, NDArray[np.generic]]] = [
        (axis, '<f4', model.points[:, k]) for k, axis in enumerate(_AXES)
    ]
    if model.rgb is not None:
        red, green, blue = model.rgb.astype(np.uint32).T
        columns.append(('rgba', '<u4', np.uint32(0xFF000000) | red << 16 | green << 8 | blue))
    columns += [(f'normal_{axis}', '<f4', model.normals[:, k]) for k, axis in enumerate(_AXES)]
    names = ' '.join(name for name, _, _ in columns)
    kinds = ' '.join('U' if kind == '<u4' else 'F' for _, kind, _ in columns)
    n = len(model.points)
    header = (
        '# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n'
        f'FIELDS {names}\nSIZE {" ".join("4" * len(columns))}\nTYPE {kinds}\n'
        f'COUNT {" ".join("1" * len(columns))}\nWIDTH {n}\nHEIGHT 1\n'
        f'VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n'
    )
    return header.encode() + _table(columns)


def cloud_ply(model: Model) -> bytes:
    """Binary PLY of the model's points with normals and, where there is one, colour."""
    columns = _positions(model.points, model.normals)
    columns += _colours(model.rgb)
    return _ply_header(columns, len(model.points), None).encode() + _table(columns)


def mesh_ply(model: Model) -> bytes:
    """Binary PLY of the model's mesh with outward vertex normals and, where there is one, colour."""
    columns = _positions(model.vertices, vertex_normals(model.vertices, model.triangles))
    columns += _colours(model.vertex_rgb)
    faces = np.empty(len(model.triangles), np.dtype([('count', 'u1'), ('index', '<i4', 3)]))
    faces['count'], faces['index'] = 3, model.triangles
    header = _ply_header(columns, len(model.vertices), len(faces))
    return header.encode() + _table(columns) + faces.tobytes()


def closed_ply(mesh: ClosedMesh) -> bytes:
    """Binary PLY of a closed mesh, each face with ``observed``: 1, or 0 of what fills a gap."""
    columns = _positions(mesh.vertices, mesh.normals) + _colours(mesh.rgb)
    faces = np.empty(
        len(mesh.triangles), np.dtype([('count', 'u1'), ('index', '<i4', 3), ('observed', 'u1')])
    )
    faces['count'], faces['index'], faces['observed'] = 3, mesh.triangles, mesh.observed
    header = _ply_header(columns, len(mesh.vertices), len(faces), ['uchar observed'])
    return header.encode() + _table(columns) + faces.tobytes()


def mesh_vtk(model: Model) -> bytes:
    """Legacy VTK 3.0 polygon data of the model's mesh with outward vertex normals, big-endian."""
    m, t = len(model.vertices), len(model.triangles)
    polygons = np.full((t, 4), 3, '>i4')
    polygons[:, 1:] = model.triangles
    normals = vertex_normals(model.vertices, model.triangles)
    return b''.join(
        [
            b'# vtk DataFile Version 3.0\nmodel in metres\nBINARY\nDATASET POLYDATA\n',
            f'POINTS {m} float\n'.encode(),
            model.vertices.astype('>f4').tobytes(),
            f'\nPOLYGONS {t} {4 * t}\n'.encode(),
            polygons.tobytes(),
            f'\nPOINT_DATA {m}\nNORMALS normals float\n'.encode(),
            normals.astype('>f4').tobytes(),
            b'\n',
        ]
    )


def _positions(
    points: NDArray[np.floating], normals: NDArray[np.floating]
) -> list[tuple[str, str, NDArray[np.generic]]]:
    columns: list[tuple[str, str, NDArray[np.generic]]] = [
        (axis, '<f4', points[:, k]) for k, axis in enumerate(_AXES)
    ]
    return columns + [(f'n{axis}', '<f4', normals[:, k]) for k, axis in enumerate(_AXES)]


def _colours(rgb: NDArray[np.uint8] | None) -> list[tuple[str, str, NDArray[np.generic]]]:
    names = () if rgb is None else ('red', 'green', 'blue')
    return [(name, 'u1', rgb[:, k]) for k, name in enumerate(names) if rgb is not None]


def _table(columns: list[tuple[str, str, NDArray[np.generic]]]) -> bytes:
    rows = np.empty(len(columns[0][2]), np.dtype([(name, kind) for name, kind, _ in columns]))
    for name, _, values in columns:
        rows[name] = values
    return rows.tobytes()


def _ply_header(
    columns: list[tuple[str, str, NDArray[np.generic]]],
    vertices: int,
    faces: int | None,
    of_faces: Sequence[str] = (),
) -> str:
    lines = ['ply', 'format binary_little_endian 1.0', f'element vertex {vertices}']
    lines += [f'property {"uchar" if kind == "u1" else "float"} {name}' for name, kind, _ in columns]
    if faces is not None:
        lines += [f'element face {faces}', 'property list uchar int vertex_indices']
        lines += [f'property {what}' for what in of_faces]
    return '\n'.join([*lines, 'end_header', ''])
