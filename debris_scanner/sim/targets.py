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

"""The targets of the simulator: named bodies of 0.25-0.4 m, or any mesh file; and their paint.

Every body is made of closed solids and centred at the centroid of its surface. Its long or symmetry
axis is z, which is what the motions spin it about by default. Paint is fixed to its points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array, apply, exp_so3, inverse
from debris_scanner.core.parameters import did_you_mean
from debris_scanner.io.mesh_files import SUFFIXES, MeshFileError, read_mesh
from debris_scanner.sim.shapes import (
    Solid,
    box,
    bumpy_sphere,
    dome,
    extrude,
    join,
    lathe,
    loft,
    mirror_x,
    place,
    rod,
)

STRIPE_M = 0.06  # width of the stripes along each axis
BACKGROUND = (30, 30, 34)
_DARK, _BRIGHT = 60, 220  # of each colour
_ASTEROID_SEED = 7  # always the same asteroid: the noise seed must not change the target


@dataclass(frozen=True)
class Target:
    """Triangle mesh in metres, target frame, outward triangles; an empty scene has none."""

    name: str
    vertices: NDArray[np.float32]  # (n, 3)
    triangles: NDArray[np.int32]  # (t, 3)

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from the origin, metres; 0 for an empty scene."""
        return float(np.linalg.norm(self.vertices, axis=1).max()) if len(self.vertices) else 0.0


def _booster(x: float) -> Solid:
    profile = [(0.0, -21.5), (2.3, -21.5), (1.85, -18.5), (1.85, 20.0), (1.5, 22.3), (0.6, 24.5), (0.0, 24.5)]
    return place(lathe(profile, 32), (x, 0.0, 0.0))


def _tank() -> Solid:
    ogive = [(4.2, 14.0), (3.9, 17.5), (3.1, 21.0), (1.9, 23.8), (0.7, 25.6), (0.0, 26.0)]
    return lathe([*reversed(dome(4.2, -3.0, -18.5)), *ogive], 64)


def _tank_boosters() -> list[Solid]:
    struts = [rod((-6.4, y, z), (6.4, y, z), 0.35, 8) for y, z in ((0.0, 13.0), (1.5, -14.0), (-1.5, -14.0))]
    return [_tank(), _booster(-6.5), _booster(6.5), *struts]


def _section(half_width: float, bottom: float, top: float, z: float) -> Array:
    """Cross-section of the orbiter's fuselage: flat belly, round back, (28, 3)."""
    angle = np.linspace(0.0, np.pi, 20)
    back = np.column_stack([half_width * np.cos(angle), bottom + 1.2 + (top - bottom - 1.2) * np.sin(angle)])
    belly = np.column_stack([np.linspace(-half_width, half_width, 10)[1:-1] * 0.96, np.full(8, bottom)])
    return np.column_stack([np.concatenate([back, belly]), np.full(28, z)])


def _orbiter() -> list[Solid]:
    """Winged orbiter, nose towards +z, back towards +y, in metres of the real one."""
    stations = [
        (0.3, -1.6, -0.2, 17.4),
        (1.3, -2.3, 0.9, 16.2),
        (2.1, -2.7, 2.2, 13.5),
        (2.6, -2.8, 3.3, 11.0),
        (2.7, -2.8, 3.4, -10.0),
        (2.9, -2.8, 3.7, -13.5),
        (2.7, -2.4, 3.4, -15.0),
    ]
    fuselage = loft(np.stack([_section(*s) for s in stations]))
    strake = extrude(np.array([[2.0, 9.0], [4.6, 0.0], [4.6, -13.2], [2.0, -13.5]]), -2.9, -2.0, axis=1)
    wing = extrude(np.array([[4.0, 0.7], [11.9, -9.5], [11.9, -12.5], [4.0, -13.2]]), -2.88, -2.02, axis=1)
    pod_sections = [
        np.column_stack([1.3 * r * np.cos(a) + 1.9, 1.2 * r * np.sin(a) + 3.3, np.full(16, z)])
        for r, z in ((0.35, -9.0), (0.9, -11.0), (1.0, -14.0), (0.8, -15.6))
        for a in [np.linspace(0, 2 * np.pi, 16, endpoint=False)]
    ]
    pod = loft(np.stack(pod_sections))
    tail_outline = np.array([[3.0, -8.0], [11.3, -15.0], [11.3, -17.2], [6.0, -15.2], [3.0, -14.6]])
    tail = extrude(tail_outline, -0.35, 0.35, axis=0)
    flap = box((5.0, 0.5, 2.2), (0.0, -2.3, -15.8))
    bell = [(0.7, -14.5), (1.0, -16.2), (1.25, -17.8), (0.0, -17.8)]
    bells = [place(lathe(bell, 24), (x, y, 0.0)) for x, y in ((0.0, 2.1), (-1.4, -0.6), (1.4, -0.6))]
    both = [side for part in (strake, wing, pod) for side in (part, mirror_x(part))]
    return [*both, fuselage, tail, flap, *bells]


def _shuttle_stack() -> list[Solid]:
    mount = [rod((x, 3.5, z), (x, 6.5, z), 0.4, 8) for x, z in ((0.0, 9.0), (-1.6, -14.0), (1.6, -14.0))]
    return [*_tank_boosters(), *(place(part, (0.0, 8.6, -5.0)) for part in _orbiter()), *mount]


def _prism() -> list[Solid]:
    return [box((0.12, 0.18, 0.3))]


def _cubesat() -> list[Solid]:
    panel = box((0.6, 0.03, 2.0), (0.92, 0.49, 0.0))
    hinge = rod((0.45, 0.49, 0.0), (0.7, 0.49, 0.0), 0.03, 8)
    lens = place(lathe([(0.22, 0.0), (0.22, 0.16), (0.17, 0.22), (0.0, 0.22)], 32), (0.12, -0.1, 1.0))
    antenna = rod((-0.35, 0.35, 1.0), (-0.35, 0.35, 1.45), 0.03, 8)
    side_box = box((0.4, 0.14, 0.55), (-0.12, -0.55, 0.35))
    return [box((1.0, 1.0, 2.0)), panel, mirror_x(panel), hinge, mirror_x(hinge), lens, antenna, side_box]


def _upper_stage() -> list[Solid]:
    tank = lathe([*reversed(dome(1.5, -0.5, -2.0)), *dome(1.5, 0.9, 2.2)], 64)
    bell = lathe([(0.0, -2.3), (0.35, -2.3), (0.3, -2.8), (0.65, -3.4), (0.95, -4.3), (0.0, -4.0)], 48)
    skirt = lathe([(0.0, 2.0), (1.56, 2.0), (1.56, 2.5), (0.0, 2.5)], 64)
    pipe = rod((1.55, 0.0, -1.9), (1.55, 0.0, 2.1), 0.13)
    boxes = [
        box((0.7, 0.35, 0.8), (0.0, 1.6, 0.6)),
        place(box((0.5, 0.3, 0.4), (0.0, 1.6, -1.2)), (0.0, 0.0, 0.0), exp_so3(np.array([0.0, 0.0, 2.0]))),
    ]
    return [tank, bell, skirt, pipe, *boxes]


def _asteroid() -> list[Solid]:
    """Ellipsoid with smooth bumps and craters of several sizes."""
    vertices, triangles = bumpy_sphere(np.random.default_rng(_ASTEROID_SEED), 60, (0.12, 0.5))
    return [(vertices * np.array([0.65, 0.75, 1.0]), triangles)]


def _defunct_satellite() -> list[Solid]:
    intact = box((1.5, 0.04, 0.7), (1.55, 0.0, 0.1))
    # the other panel broke in its hinge: shorter, bent and turned
    broken = place(
        box((0.8, 0.04, 0.7), (-0.4, 0.0, 0.0)), (-0.75, 0.05, 0.1), exp_so3(np.array([0.5, 0.3, 0.25]))
    )
    hinges = [
        rod((0.45, 0.0, 0.1), (0.85, 0.0, 0.1), 0.04, 8),
        rod((-0.85, 0.05, 0.1), (-0.45, 0.0, 0.1), 0.04, 8),
    ]
    bowl = [(0.04, 0.0), (0.25, 0.05), (0.42, 0.14), (0.55, 0.26)]
    dish = lathe([*bowl, *((r - 0.015, z + 0.025) for r, z in reversed(bowl[1:])), (0.0, 0.03)], 48)
    dish = place(dish, (0.1, 0.15, 0.85), exp_so3(np.array([-0.35, 0.2, 0.0])))
    boom = rod((0.0, -0.3, -0.7), (-0.25, -1.5, -1.0), 0.045)
    tip = box((0.22, 0.18, 0.14), (-0.25, -1.5, -1.0))
    thruster = lathe([(0.0, -0.65), (0.12, -0.7), (0.25, -1.05), (0.0, -1.0)], 24)
    return [
        box((1.0, 0.9, 1.5)),
        intact,
        broken,
        *hinges,
        dish,
        rod((0, 0, 0.7), (0.1, 0.15, 0.9), 0.07),
        boom,
        tip,
        thruster,
    ]


def _cylinder() -> list[Solid]:
    # so fine that its facets, 0.02 mm high, cannot be distinguished from a round body
    return [lathe([(0.0, -0.15), (0.09, -0.15), (0.09, 0.15), (0.0, 0.15)], 256)]


# Builder and default largest extent, metres, of each target.
_BUILDERS: dict[str, tuple[Callable[[], list[Solid]], float]] = {
    'shuttle_stack': (_shuttle_stack, 0.36),
    'tank_boosters': (_tank_boosters, 0.34),
    'prism': (_prism, 0.30),
    'cubesat': (_cubesat, 0.30),
    'upper_stage': (_upper_stage, 0.36),
    'asteroid': (_asteroid, 0.28),
    'defunct_satellite': (_defunct_satellite, 0.40),
    'cylinder': (_cylinder, 0.30),
}
TARGET_NAMES = (*_BUILDERS, 'empty')
DEFAULT_FILE_SIZE = 0.35


def make_target(name_or_path: str | Path, size: float | None = None) -> Target:
    """The target of a name in ``TARGET_NAMES`` or of a mesh file (OBJ, STL, PLY).

    Args:
        name_or_path: a name, or a path ending in one of ``mesh_files.SUFFIXES``.
        size: largest extent along the mesh's axes, metres; None takes the target's own,
            ``DEFAULT_FILE_SIZE`` for a file.

    Raises:
        ValueError: unknown name, a size that is not positive, or a file that holds no mesh.
    """
    if size is not None and not 0 < size < np.inf:
        raise ValueError(f'size must be a positive number of metres, not {size!r}')
    name = str(name_or_path)
    if name == 'empty':
        return Target(name, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    if name in _BUILDERS:
        build, default = _BUILDERS[name]
        return scaled(name, join(build()), size or default)
    if Path(name).suffix.lower() in SUFFIXES:
        return scaled(Path(name).stem, read_mesh(Path(name)), size or DEFAULT_FILE_SIZE)
    raise ValueError(
        f'unknown target {name!r}: choose one of {", ".join(TARGET_NAMES)}, '
        f'or a mesh file ending in {", ".join(SUFFIXES)}{did_you_mean(name, TARGET_NAMES)}'
    )


def scaled(name: str, mesh: Solid, size: float) -> Target:
    """A target about its centroid, of a mesh of any unit.

    Args:
        name: of the target.
        mesh: its shape.
        size: largest extent along the mesh's axes, metres.

    Raises:
        MeshFileError: the mesh has no finite extent.
    """
    vertices, triangles = mesh
    extent = float(np.ptp(vertices, axis=0).max())
    if not 0 < extent < np.inf:
        raise MeshFileError(f'{name}: the mesh has no finite extent')
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    centroid = (corners.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()
    scaled = (vertices - centroid) * (size / extent)
    return Target(name, np.ascontiguousarray(scaled, np.float32), np.ascontiguousarray(triangles, np.int32))


def paint(
    depth_mm: NDArray[np.integer] | NDArray[np.floating], camera: Camera, T_sensor_target: Array
) -> NDArray[np.uint8]:
    """Colours (h, w, 3) of a depth image, millimetres, 0 invalid.

    Soft stripes: red along the target's x axis, green along y, blue along z.
    """
    rgb = np.empty((*depth_mm.shape, 3), np.uint8)
    rgb[:] = BACKGROUND
    v, u = np.nonzero(depth_mm)
    z = depth_mm[v, u] * 0.001
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    rgb[v, u] = paint_at(apply(inverse(T_sensor_target), points))
    return rgb


def paint_at(points: Array) -> NDArray[np.uint8]:
    """Colours (n, 3) of points (n, 3) of the target, metres, target frame."""
    wave = 0.5 + 0.5 * np.sin(points * (np.pi / STRIPE_M))
    return np.asarray(np.rint(_DARK + (_BRIGHT - _DARK) * wave), np.uint8)
