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

"""What of the closed surface has been seen, and from where its gaps show."""

from typing import Any

import numpy as np

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import Array
from debris_scanner.modelling.closing import parts

SMALLEST_OPENING = 1e-3  # share of the surface: smaller ones are seams
LARGE_OPENING = 1e-2  # share of the surface: the inside would show from its direction


def coverage(model: Model) -> dict[str, Any] | None:
    """For summary.json; None of a model without a closed surface.

    ``observed_share`` of the closed surface; ``openings``, their ``number`` and whole ``area_m2``;
    ``unseen_directions``: for each large opening the unit vector, target frame, that it faces.
    """
    if model.closed is None:
        return None
    areas, facing = _openings(model.closed)
    surface = float(np.linalg.norm(_faces(model.closed), axis=1).sum())
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


def _faces(mesh: ClosedMesh) -> Array:
    """Area of each face times its normal, (t, 3), m²."""
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _openings(mesh: ClosedMesh) -> tuple[Array, Array]:
    """Areas (k,), m², of the patches that nobody saw, and the unit vectors (k, 3) that they face."""
    faces = _faces(mesh)[~mesh.observed]
    if not len(faces):
        return np.zeros(0), np.zeros((0, 3))
    _, part = np.unique(parts(mesh.triangles[~mesh.observed], len(mesh.vertices)), return_inverse=True)
    areas = np.bincount(part, np.linalg.norm(faces, axis=1))
    sums = np.column_stack([np.bincount(part, faces[:, k]) for k in range(3)])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    facing: Array = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)
    return np.asarray(areas, np.float64), facing
