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

"""The closed surface for other programs: glTF for viewers, STL for printers, URDF for simulators."""

from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh

from debris_scanner.core.frames import ClosedMesh
from debris_scanner.io.model_files import closed_ply
from debris_scanner.modelling.solid import solid

OBJ = 'mesh_closed.obj'
GREY, FILLED = 190, 0.7  # of a target without colour; shade of what fills a gap
DENSITY = 1000.0  # kg/m³ in the URDF: nobody knows the target's


def glb(mesh: ClosedMesh) -> bytes:
    """Binary glTF, metres, coloured; what nobody saw is darker."""
    rgb = np.full((len(mesh.vertices), 3), GREY, np.uint8) if mesh.rgb is None else mesh.rgb.copy()
    filled = np.setdiff1d(mesh.triangles[~mesh.observed], mesh.triangles[mesh.observed])
    rgb[filled] = (rgb[filled] * FILLED).astype(np.uint8)
    return _exported(mesh, 'glb', rgb)


def stl(mesh: ClosedMesh) -> bytes:
    """Binary STL in millimetres, as slicers expect it."""
    return _exported(mesh, 'stl', scale=1000.0)


def obj(mesh: ClosedMesh) -> bytes:
    """Wavefront OBJ in metres, with vertex colours behind the coordinates where there are any."""
    return _exported(mesh, 'obj', mesh.rgb)


def urdf(mesh: ClosedMesh) -> bytes:
    """One link: the closed mesh as visual and collision, and its inertia at uniform density."""
    body = solid(mesh)
    mass = DENSITY * body.volume
    at = ' '.join(f'{x:.9g}' for x in body.centroid)
    moments = ' '.join(
        f'i{"xyz"[i]}{"xyz"[j]}="{mass * body.inertia[i, j]:.9g}"' for i in range(3) for j in range(i, 3)
    )
    geometry = f'<geometry><mesh filename="{OBJ}"/></geometry>'
    return (
        '<?xml version="1.0"?>\n'
        f'<!-- Nobody weighed it: {DENSITY:.0f} kg/m3. What the motion tells is in summary.json. -->\n'
        # MuJoCo would merge a body without a joint into the world, and forget its mass
        '<robot name="target">\n  <mujoco><compiler fusestatic="false"/></mujoco>\n'
        '  <link name="target">\n    <inertial>\n'
        f'      <origin xyz="{at}" rpy="0 0 0"/>\n      <mass value="{mass:.9g}"/>\n'
        f'      <inertia {moments}/>\n'
        f'    </inertial>\n    <visual>{geometry}</visual>\n    <collision>{geometry}</collision>\n'
        '  </link>\n</robot>\n'
    ).encode()


CLOSED_FILES: dict[str, Callable[[ClosedMesh], bytes]] = {
    'mesh_closed.ply': closed_ply,
    'mesh_closed.stl': stl,
    OBJ: obj,
    'mesh.glb': glb,
    'target.urdf': urdf,
}


def _exported(mesh: ClosedMesh, kind: str, rgb: Any = None, scale: float = 1.0) -> bytes:
    whole = trimesh.Trimesh(scale * mesh.vertices, mesh.triangles, vertex_colors=rgb, process=False)
    data = whole.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)
