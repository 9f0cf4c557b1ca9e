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

"""Voxel grid: one point per cubic leaf, the mean of the points inside, in PCL's order.

Trowbridge 2014, section 3.2. Leaves are aligned with the axes' origin and come out by their linear
index within the cloud's bounding box, x fastest, as from PCL's VoxelGrid.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Leaves:
    """Points grouped by leaf: ``order`` (k,) sorts them, ``starts`` (m,) is where each leaf begins."""

    order: NDArray[np.intp]
    starts: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def counts(self) -> NDArray[np.intp]:
        """Points in each leaf, (m,)."""
        return np.diff(self.starts, append=len(self.order))

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Mean (m, c) over each leaf of values (n, c) that belong to the points."""
        result = np.empty((len(self), values.shape[1]))
        if not len(self):
            return result
        # One contiguous column at a time: reduceat along rows of three is several times slower.
        for k in range(values.shape[1]):
            result[:, k] = np.add.reduceat(values[self.order, k], self.starts, dtype=np.float64)
        return result / self.counts[:, None]


def group(points: NDArray[np.floating], leaf: float) -> Leaves:
    """Group points (n, 3) by cubes of edge ``leaf``, same unit; points that are not finite are left out.

    Raises:
        ValueError: for a leaf that is not positive, or so small that leaves cannot be numbered.
    """
    if not leaf > 0:
        raise ValueError(f'leaf size must be positive, got {leaf}')
    finite = np.isfinite(points).all(axis=1)
    rows = np.arange(len(points)) if finite.all() else np.flatnonzero(finite)
    if not len(rows):
        return Leaves(rows, rows)
    # Single precision as in PCL: a point on the face of a cube must fall to the same side.
    inverse = np.float32(1.0) / np.float32(leaf)
    extent, cell = [], []
    for k in range(3):
        column = points[:, k] if len(rows) == len(points) else points[rows, k]
        scaled = np.floor(column.astype(np.float32, copy=False) * inverse)
        low = scaled.min()
        extent.append(int(scaled.max()) - int(low) + 1)
        # Not by difference of floats: large coordinates over small leaves exceed their exact integers.
        cell.append(scaled.astype(np.int64) - int(low))
    bits = len(rows).bit_length()
    if extent[0] * extent[1] * extent[2] >= 1 << (63 - bits):
        raise ValueError(f'leaf size {leaf} is too small for a cloud of {extent} leaves')
    index = cell[0] + extent[0] * (cell[1] + extent[1] * cell[2])
    # Leaf and row in one number: sorting numbers is faster than sorting indices, and it is stable.
    keys = np.sort(index << bits | np.arange(len(rows)))
    sorted_index = keys >> bits
    order = rows[keys & ((1 << bits) - 1)]
    starts = np.flatnonzero(np.concatenate([[True], sorted_index[1:] != sorted_index[:-1]]))
    return Leaves(order, starts)


def voxel_grid(points: NDArray[np.floating], leaf: float) -> NDArray[np.float32]:
    """Centroids (m, 3) of the occupied leaves of points (n, 3), metres; raises as :func:`group`."""
    return group(points, leaf).mean(points).astype(np.float32)


def voxel_grid_with_normals(
    points: NDArray[np.floating], normals: NDArray[np.floating], leaf: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centroids (m, 3) and unit mean normals (m, 3) of the occupied leaves; raises as :func:`group`.

    Opposite normals cancel: a leaf whose mean vanishes has the normal zero. Normals must be finite.
    """
    leaves = group(points, leaf)
    mean = leaves.mean(normals)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    unit = np.divide(mean, length, out=np.zeros_like(mean), where=length > 1e-6)
    return leaves.mean(points).astype(np.float32), unit.astype(np.float32)
