"""The model of a target: refined cloud and triangle mesh, in the target frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Model:
    """Surface of the target, metres, target frame.

    That is the first key frame's attitude, as the first model had it, with the origin at the centroid.
    """

    points: NDArray[np.float32]  # (n, 3)
    normals: NDArray[np.float32]  # (n, 3), unit, outward
    vertices: NDArray[np.float32]  # (m, 3) of the mesh
    triangles: NDArray[np.int32]  # (t, 3), counter-clockwise seen from outside
    rgb: NDArray[np.uint8] | None = None  # (n, 3)

    @property
    def radius(self) -> float:
        """Largest distance of a point from the origin, metres."""
        return float(np.linalg.norm(self.points, axis=1).max())
