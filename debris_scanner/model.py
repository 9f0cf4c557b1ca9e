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

"""The model of a target: refined cloud and triangle mesh, in the target frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CLOUD_VOXEL = 0.002  # m: spacing of the model cloud, as the thesis's voxel grid (T3)


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
