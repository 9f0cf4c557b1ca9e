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

"""Figures of the closed mesh: what of it has been seen, and its mass properties if it were filled evenly."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import Array, area, faces
from debris_scanner.modelling.closing import parts

SMALLEST_OPENING = 1e-3  # share of the surface: smaller ones are seams
LARGE_OPENING = 1e-2  # share of the surface: the inside would show from its direction


@dataclass(frozen=True)
class Solid:
    """Of a closed mesh at uniform density, target frame."""

    volume: float  # m³
    centroid: Array  # (3,) m
    inertia: Array  # (3, 3) about the centroid over the mass, m²

    @property
    def principal(self) -> tuple[Array, Array]:
        """Moments (3,) over the mass, m², least first, and the axes (3, 3) in columns, right-handed."""
        moments, axes = np.linalg.eigh(self.inertia)
        return moments, axes * np.sign(np.linalg.det(axes))

    def told(self, by_motion: dict[str, Any] | None) -> dict[str, Any]:
        """For summary.json; how far it is from what the motion tells, if that tells anything."""
        moments, axes = self.principal
        told: dict[str, Any] = {
            'volume_m3': self.volume,
            'centroid_m': self.centroid.tolist(),
            'inertia_ratios': (moments[:2] / moments[2]).tolist(),
            'principal_axes': axes.T.tolist(),  # unit vectors, least moment first
        }
        if by_motion is not None and by_motion['observable']:
            cosines = np.abs(np.einsum('ij,ji->i', np.array(by_motion['principal_axes']), axes))
            apart = np.array(by_motion['centre_of_mass_m']) - self.centroid
            told['centre_of_mass_apart_m'] = float(np.linalg.norm(apart))
            told['principal_axes_apart_deg'] = np.degrees(np.arccos(np.minimum(cosines, 1.0))).tolist()
        return told


def solid(mesh: ClosedMesh) -> Solid:
    """Volume, centroid and inertia, exact for the mesh: sums over tetrahedra from the origin to each face.

    Tonon (2005), "Explicit exact formulas for the 3-D tetrahedron inertia tensor".
    """
    corners: NDArray[np.float64] = mesh.vertices[mesh.triangles].astype(np.float64)
    volumes = np.linalg.det(corners) / 6
    volume = float(volumes.sum())
    sums = corners.sum(axis=1)
    centroid = np.einsum('n,ni->i', volumes, sums) / (4 * volume)
    # second moments of a tetrahedron with a corner at the origin: V/20 (sum c c' + s s')
    second = np.einsum('n,nki,nkj->ij', volumes, corners, corners, optimize=True)
    second = (second + np.einsum('n,ni,nj->ij', volumes, sums, sums, optimize=True)) / (20 * volume)
    second -= np.outer(centroid, centroid)
    return Solid(volume, centroid, np.trace(second) * np.eye(3) - second)


def coverage(model: Model) -> dict[str, Any] | None:
    """For summary.json; None of a model without a closed surface.

    ``observed_share`` of the closed surface; ``openings``, their ``number`` and whole ``area_m2``;
    ``unseen_directions``: for each large opening the unit vector, target frame, that it faces.
    """
    if model.closed is None:
        return None
    areas, facing = _openings(model.closed)
    surface = area(model.closed.vertices, model.closed.triangles)
    order = np.argsort(-areas, kind='stable')
    large = [n for n in order.tolist() if areas[n] > LARGE_OPENING * surface]
    return {
        'observed_share': float(1 - areas.sum() / surface),
        'openings': {
            'number': int(np.count_nonzero(areas > SMALLEST_OPENING * surface)),
            'area_m2': float(areas.sum()),
        },
        'unseen_directions': [facing[n].round(6).tolist() for n in large],
    }


def _openings(mesh: ClosedMesh) -> tuple[Array, Array]:
    """Areas (k,), m², of the patches that nobody saw, and the unit vectors (k, 3) that they face."""
    unseen = faces(mesh.vertices, mesh.triangles[~mesh.observed])
    if not len(unseen):
        return np.zeros(0), np.zeros((0, 3))
    _, part = np.unique(parts(mesh.triangles[~mesh.observed], len(mesh.vertices)), return_inverse=True)
    areas = np.bincount(part, np.linalg.norm(unseen, axis=1))
    sums = np.column_stack([np.bincount(part, unseen[:, k]) for k in range(3)])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    facing: Array = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)
    return np.asarray(areas, np.float64), facing
