"""Moving every frame's cloud to about where it belongs before the relaxation (T17).

Trowbridge 2014, section 3.2: the cloud's centroid goes to the origin and the cloud is turned by the
filter's attitude. What the observer's own translation did to the clouds is gone after that, but the
centroid of the visible side wanders over the target as it turns, and the relaxation has to find that.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.geometry import Array, project_so3, transform


def prealign(points: NDArray[np.floating], R_sensor_target: Array) -> tuple[Array, Array]:
    """Points (n, 3) in the target's attitude about their centroid, and that transform (4, 4).

    Args:
        points: of one frame, sensor frame, metres.
        R_sensor_target: (3, 3) attitude estimate.
    """
    centroid = points.mean(axis=0, dtype=np.float64)
    R = project_so3(R_sensor_target).T
    return (points.astype(np.float64) - centroid) @ R.T, transform(R, -R @ centroid)
