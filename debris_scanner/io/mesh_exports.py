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

"""The closed surface for other programs: glTF for viewers, STL for printers, URDF and SDF for simulators."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from debris_scanner.core.frames import ClosedMesh, Texture
from debris_scanner.io.model_files import closed_ply
from debris_scanner.modelling.solid import solid

if TYPE_CHECKING:
    import trimesh

OBJ, MTL, PNG, STL = 'mesh_closed.obj', 'mesh_closed.mtl', 'mesh_closed.png', 'mesh_closed.stl'
IN_MILLIMETRES = b'debris_scanner: unit millimetre'
GREY, FILLED = 190, 0.7  # of a target without colour; shade of what fills a gap
DENSITY = 1000.0  # kg/m³ for simulators: nobody knows the target's
REMARK = f'<!-- Nobody weighed it: {DENSITY:.0f} kg/m3. What the motion tells is in summary.json. -->\n'


def glb(mesh: ClosedMesh) -> bytes:
    """Binary glTF, metres, with its texture or colours; what nobody saw is darker."""
    if mesh.texture is not None:
        return _textured_glb(mesh, mesh.texture)
    rgb = np.full((len(mesh.vertices), 3), GREY, np.uint8) if mesh.rgb is None else mesh.rgb.copy()
    filled = np.setdiff1d(mesh.triangles[~mesh.observed], mesh.triangles[mesh.observed])
    rgb[filled] = (rgb[filled] * FILLED).astype(np.uint8)
    return _exported(mesh, 'glb', rgb)


def stl(mesh: ClosedMesh) -> bytes:
    """Binary STL in millimetres, as slicers expect it; its header says so."""
    return IN_MILLIMETRES.ljust(80) + _exported(mesh, 'stl', scale=1000.0)[80:]


def is_in_millimetres(path: Path) -> bool:
    """Whether a file is an STL of :func:`stl`, whatever its name, or of an earlier release, by its name."""
    if path.suffix.lower() != '.stl' or not path.is_file():
        return False
    with path.open('rb') as file:
        return file.read(80).startswith(IN_MILLIMETRES) or path.name == STL


def obj(mesh: ClosedMesh) -> bytes:
    """Wavefront OBJ in metres, with its texture, or else vertex colours behind the coordinates if it has any.

    The texture's pieces share the vertices between them, so the mesh is closed for those that read it.
    """
    if mesh.texture is not None:
        return _textured_obj(mesh, mesh.texture)
    return _exported(mesh, 'obj', mesh.rgb)


def urdf(mesh: ClosedMesh) -> bytes:
    """One link: the closed mesh as visual and collision, and its inertia at uniform density."""
    at, mass, moments = _inertial(mesh)
    inertia = ' '.join(f'{name}="{value}"' for name, value in moments.items())
    geometry = f'<geometry><mesh filename="{OBJ}"/></geometry>'
    return (
        '<?xml version="1.0"?>\n'
        f'{REMARK}'
        # MuJoCo would merge a body without a joint into the world, and forget its mass
        '<robot name="target">\n  <mujoco><compiler fusestatic="false"/></mujoco>\n'
        '  <link name="target">\n    <inertial>\n'
        f'      <origin xyz="{at}" rpy="0 0 0"/>\n      <mass value="{mass}"/>\n'
        f'      <inertia {inertia}/>\n'
        f'    </inertial>\n    <visual>{geometry}</visual>\n    <collision>{geometry}</collision>\n'
        '  </link>\n</robot>\n'
    ).encode()


def sdf(mesh: ClosedMesh) -> bytes:
    """The same as :func:`urdf` for Gazebo: a model of one link, that moves freely."""
    at, mass, moments = _inertial(mesh)
    inertia = ''.join(f'<{name}>{value}</{name}>' for name, value in moments.items())
    geometry = f'<geometry><mesh><uri>{OBJ}</uri></mesh></geometry>'
    return (
        '<?xml version="1.0"?>\n'
        f'{REMARK}'
        '<sdf version="1.7">\n  <model name="target">\n    <link name="target">\n      <inertial>\n'
        f'        <pose>{at} 0 0 0</pose>\n        <mass>{mass}</mass>\n'
        f'        <inertia>{inertia}</inertia>\n      </inertial>\n'
        f'      <visual name="visual">{geometry}</visual>\n'
        f'      <collision name="collision">{geometry}</collision>\n'
        '    </link>\n  </model>\n</sdf>\n'
    ).encode()


def _inertial(mesh: ClosedMesh) -> tuple[str, str, dict[str, str]]:
    """Centroid, mass and moments of inertia about the centroid, at uniform density."""
    body = solid(mesh)
    mass = DENSITY * body.volume
    moments = {
        f'i{"xyz"[i]}{"xyz"[j]}': f'{mass * body.inertia[i, j]:.9g}' for i in range(3) for j in range(i, 3)
    }
    return ' '.join(f'{x:.9g}' for x in body.centroid), f'{mass:.9g}', moments


def mtl(texture: Texture) -> bytes:
    """The material of the OBJ file: the texture, and no gloss."""
    return f'newmtl target\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {PNG}\n'.encode()


def png(texture: Texture) -> bytes:
    """The texture's image."""
    return _encoded(texture.image)


CLOSED_FILES: dict[str, Callable[[ClosedMesh], bytes]] = {
    'mesh_closed.ply': closed_ply,
    STL: stl,
    OBJ: obj,
    'mesh.glb': glb,
    'target.urdf': urdf,
    'target.sdf': sdf,
}
TEXTURE_FILES: dict[str, Callable[[Texture], bytes]] = {MTL: mtl, PNG: png}  # beside the OBJ file


def _trimesh() -> Any:
    """The library, loaded late: of all processes of a live scan one alone needs its 20 MB."""
    import trimesh as library

    return library


def _exported(mesh: ClosedMesh, kind: str, rgb: Any = None, scale: float = 1.0) -> bytes:
    whole = _trimesh().Trimesh(scale * mesh.vertices, mesh.triangles, vertex_colors=rgb, process=False)
    return _bytes(whole, kind)


def _bytes(whole: 'trimesh.Trimesh', kind: str) -> bytes:
    data: Any = whole.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def _textured_glb(mesh: ClosedMesh, texture: Texture) -> bytes:
    shaded = np.where(texture.observed[..., None], texture.image, texture.image * FILLED).astype(np.uint8)
    library = _trimesh()
    visual = library.visual
    # without the two factors glTF means polished metal
    material = visual.material.PBRMaterial(
        baseColorTexture=Image.open(io.BytesIO(_encoded(shaded))), metallicFactor=0.0, roughnessFactor=1.0
    )
    whole = library.Trimesh(
        mesh.vertices[texture.vertices],
        texture.triangles,
        visual=visual.TextureVisuals(uv=_upwards(texture), material=material),
        process=False,
    )
    return _bytes(whole, 'glb')


def _textured_obj(mesh: ClosedMesh, texture: Texture) -> bytes:
    corners = np.stack([mesh.triangles, texture.triangles], axis=-1) + 1
    return (
        f'mtllib {MTL}\nusemtl target\n'
        + _lines('v %.8g %.8g %.8g\n', mesh.vertices)
        + _lines('vt %.6f %.6f\n', _upwards(texture))
        + _lines('f %d/%d %d/%d %d/%d\n', corners)
    ).encode()


def _lines(pattern: str, rows: NDArray[Any]) -> str:
    return (pattern * len(rows)) % tuple(rows.ravel().tolist())


def _upwards(texture: Texture) -> NDArray[np.float32]:
    """Places (k, 2) in the image from its lower left corner."""
    return np.column_stack([texture.uv[:, 0], np.float32(1) - texture.uv[:, 1]])


def _encoded(image: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, 'PNG')
    return file.getvalue()
