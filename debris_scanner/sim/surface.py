"""A triangle mesh to cast rays at and to measure distances to."""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.sim.open3d_library import load_open3d


class Surface:
    """Triangles that rays are cast at and distances are taken to, in their own frame."""

    def __init__(
        self, vertices: NDArray[np.floating], triangles: NDArray[np.integer], threads: int = 1
    ) -> None:
        """Build the search tree of vertices (n, 3) and triangles (t, 3)."""
        self._o3d = load_open3d()
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(
        self, origin: NDArray[np.float32], direction: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances (...) in lengths of direction, inf for a miss, and the mesh's unit normals (..., 3).

        Args:
            origin: (3,) of all rays.
            direction: (..., 3).
        """
        rays = np.empty((*direction.shape[:-1], 6), np.float32)
        rays[..., :3], rays[..., 3:] = origin, direction
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        return hit['t_hit'].numpy(), hit['primitive_normals'].numpy()

    def distance(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Unsigned distance (n,) of points (n, 3) to the surface."""
        query = self._o3d.core.Tensor(np.ascontiguousarray(points, np.float32))
        return np.asarray(self._scene.compute_distance(query).numpy(), np.float32)
