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

"""Moving every frame's cloud to about where it belongs before the relaxation (T17).

Trowbridge 2014, section 3.2: the cloud's centroid goes to the origin and the cloud is turned by the
filter's attitude. What the observer's own translation did to the clouds is gone after that, but the
centroid of the visible side wanders over the target as it turns, and the relaxation has to find that.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, project_so3, transform


def prealign(points: NDArray[np.floating], R_sensor_target: Array) -> tuple[Array, Array]:
    """Points (n, 3) in the target's attitude about their centroid, and that transform (4, 4).

    Args:
        points: of one frame, sensor frame, metres.
        R_sensor_target: (3, 3) attitude estimate.
    """
    centroid = points.mean(axis=0, dtype=np.float64)
    R = project_so3(R_sensor_target).T
    return (points.astype(np.float64) - centroid) @ R.T, transform(R, -R @ centroid)
