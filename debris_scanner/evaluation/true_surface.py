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

"""The true surface of the target: distances to it, which parts were seen, and its rotational symmetry."""

from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, apply, exp_so3, inverse
from debris_scanner.io.mesh_files import read_cloud, read_mesh
from debris_scanner.sim.surface import Surface, sample_mesh

SAMPLES = 40_000  # points that stand for the whole surface
SEEN_PIXELS = 3  # a part of the surface counts as seen from here on
_CELL_M = 0.002  # parts of the surface are the cells of this grid that it passes through
_MOST_CELLS = 400  # along an edge of the grid; of larger targets the cells grow
_AGREE_M = 0.006  # a pixel measured the surface if their depths agree this well: four sigma at 0.8 m
_MAPS_ONTO_M = 0.0005  # a turned surface this near to itself counts as the same
_IN_SIGHT = 100  # pixels that must measure the target for it to be in sight


class TrueSurface:
    """A mesh, or a cloud where no mesh exists, in the true target frame, metres.

    ``samples`` (n, 3) spread evenly over the surface; a cloud's points are thinned to 2 mm. Distances to a
    mesh are to its triangles, to a cloud to its nearest point, with nothing taken off for its spacing.
    ``size`` is the largest extent along an axis, metres; 0 of nothing.
    """

    def __init__(self, mesh: tuple[Array, NDArray[np.int32]] | None, cloud: Array | None = None) -> None:
        """Of a mesh (vertices, triangles) or else a cloud (n, 3); either may be empty."""
        self._surface: Surface | None = None
        self._tree: scipy.spatial.cKDTree | None = None
        self.samples = np.zeros((0, 3))
        self.size = 0.0
        if mesh is not None and len(mesh[1]):
            self._surface = Surface(*mesh)
            self.samples = sample_mesh(*mesh, SAMPLES)
            self.size = float(np.ptp(mesh[0][mesh[1].ravel()], axis=0).max())
        elif cloud is not None and len(cloud):
            self._tree = scipy.spatial.cKDTree(cloud)
            self.size = float(np.ptp(cloud, axis=0).max())
            _, first = np.unique(np.floor(cloud / _CELL_M).astype(np.int64), axis=0, return_index=True)
            self.samples = np.asarray(cloud[first], np.float64)
        self._cell = max(_CELL_M, self.size / _MOST_CELLS)
        self._few = self.samples[:: max(1, len(self.samples) // 1000)]
        # an odd fraction of a cell, so that no face lies on the border of two
        self._low = self.samples.min(axis=0) - 1.37 * self._cell if len(self.samples) else np.zeros(3)
        extent = np.ptp(self.samples, axis=0) if len(self.samples) else np.zeros(3)
        self._counts = np.zeros((extent / self._cell).astype(int) + 3, np.int64)

    @staticmethod
    def read(folder: Path) -> 'TrueSurface':
        """From ``truth_mesh.ply`` or else ``truth_cloud.ply`` in a recording's folder.

        Raises:
            MeshFileError: the mesh cannot be read.
            FileNotFoundError: there is neither.
        """
        mesh, cloud = folder / 'truth_mesh.ply', folder / 'truth_cloud.ply'
        if mesh.is_file():
            return TrueSurface(read_mesh(mesh, allow_empty=True))
        if cloud.is_file():
            return TrueSurface(None, read_cloud(cloud))
        raise FileNotFoundError(f'neither truth_mesh.ply nor truth_cloud.ply in {folder}')

    @property
    def empty(self) -> bool:
        """Whether there is no target at all."""
        return len(self.samples) == 0

    def distance(self, points: Array) -> Array:
        """Unsigned distances (n,) of points (n, 3) to the surface, metres; inf if it is empty."""
        if self._surface is not None:
            return self._surface.distance(points)
        if self._tree is not None:
            return np.asarray(self._tree.query(points)[0], np.float64)
        return np.full(len(points), np.inf)

    def observe(self, frame: DepthFrame, T_sensor_target: Array) -> bool:
        """Count which parts of the surface a frame's pixels measured; returns whether they saw the target."""
        if self.empty:
            return False
        points = self._measured(frame, T_sensor_target)
        cells = np.floor((points - self._low) / self._cell).astype(np.intp)
        cells = cells[np.all((cells >= 0) & (cells < self._counts.shape), axis=1)]
        np.add.at(self._counts, tuple(cells.T), 1)
        return len(cells) >= _IN_SIGHT

    def seen(self) -> Array:
        """Samples (n, 3) of the parts, 2 mm across, that at least three observed pixels measured."""
        if self.empty:
            return self.samples
        cells = np.floor((self.samples - self._low) / self._cell).astype(np.intp)
        return self.samples[self._counts[tuple(cells.T)] >= SEEN_PIXELS]

    def _measured(self, frame: DepthFrame, T_sensor_target: Array) -> Array:
        """Points (n, 3), target frame, where a frame's pixels hit the surface; for a cloud, as measured."""
        v, u = np.nonzero(frame.depth > 0)
        camera, depth = frame.camera, frame.depth[v, u].astype(np.float64)
        ray = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
        T_target_sensor = inverse(T_sensor_target)
        if self._surface is None:
            return apply(T_target_sensor, ray * depth[:, None])
        origin, direction = T_target_sensor[:3, 3], ray @ T_target_sensor[:3, :3].T
        # the ray's z is 1 in the sensor frame, so that the length along it is the depth
        hit, _ = self._surface.cast(origin.astype(np.float32), direction.astype(np.float32))
        agree = np.abs(hit - depth) < _AGREE_M
        return origin + direction[agree] * hit[agree, None]

    def looks_the_same(self, rotations: Array) -> bool:
        """Whether the surface maps onto itself under each rotation (k, 3, 3) about its centroid."""
        if self._surface is None:
            return False
        centroid = self.samples.mean(axis=0)
        points = self._few - centroid
        return all(float(self.distance(points @ R.T + centroid).max()) <= _MAPS_ONTO_M for R in rotations)

    def is_body_of_revolution(self) -> bool:
        """Whether some axis exists about which no rotation can be observed."""
        if self._surface is None:
            return False
        _, axes = np.linalg.eigh(np.cov(self.samples.T))
        turns = (0.7, 1.9)  # rad: no symmetry of a polygon
        return any(self.looks_the_same(np.array([exp_so3(a * turn) for turn in turns])) for a in axes.T)
