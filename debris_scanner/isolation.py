"""Target isolation: the pass-through box, then the cluster that matters.

The box is thesis part T2 (Trowbridge 2014, section 3.2). Inside it the points fall into clusters,
found on a coarse voxel grid; the target is the largest one, or, once there is one, the cluster that
continues it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from debris_scanner.camera import Camera
from debris_scanner.frames import FrameRejected
from debris_scanner.parameters import parameter


@dataclass(frozen=True)
class IsolationSettings:
    """Where the target is looked for, in the sensor's optical frame."""

    box_min: tuple[float, float, float] = parameter(
        (-0.4, -0.4, 0.3), 'lower corner of the pass-through box', 'm'
    )
    box_max: tuple[float, float, float] = parameter(
        (0.4, 0.4, 1.2), 'upper corner of the pass-through box', 'm'
    )
    cluster_gap: float = parameter(
        0.025, 'parts of one target are at most about this far apart', 'm', 0.001, 1.0
    )
    min_pixels: int = parameter(400, 'a smaller target is not tracked', 'px', 50, 10**6)
    margin: int = parameter(16, 'free border of the window around the target', 'px', 2, 200)


class TargetIsolator:
    """Finds the target's pixels frame by frame; remembers where it was last seen."""

    def __init__(self, settings: IsolationSettings) -> None:
        self.settings = settings
        self._centroid: NDArray[np.float64] | None = None

    def mask(self, depth: NDArray[np.float32], camera: Camera) -> NDArray[np.bool_]:
        """Pixels (h, w) of a depth image (metres) that show the target.

        Raises:
            FrameRejected: ``no_target`` when too few points lie in the box.
        """
        s = self.settings
        (x0, y0, z0), (x1, y1, z1) = s.box_min, s.box_max
        v, u = np.nonzero((depth >= z0) & (depth <= z1))
        z = depth[v, u].astype(np.float64)
        x = (u - camera.cx) / camera.fx * z
        y = (v - camera.cy) / camera.fy * z
        inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        if inside.sum() < s.min_pixels:
            raise FrameRejected('no_target', f'{inside.sum()} pixels in the box')
        v, u = v[inside], u[inside]
        points = np.stack([x[inside], y[inside], z[inside]], axis=1)
        chosen = self._cluster(points)
        if chosen.sum() < s.min_pixels:
            raise FrameRejected('no_target', f'the largest cluster has {chosen.sum()} pixels')
        self._centroid = points[chosen].mean(axis=0)
        mask = np.zeros(depth.shape, np.bool_)
        mask[v[chosen], u[chosen]] = True
        return mask

    def _cluster(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points (n, 3) belong to the target's cluster."""
        cell = (points - np.array(self.settings.box_min)) / self.settings.cluster_gap
        voxel = np.floor(cell).astype(np.intp)
        grid = np.zeros(voxel.max(axis=0) + 1, np.bool_)
        grid[voxel[:, 0], voxel[:, 1], voxel[:, 2]] = True
        labels, count = ndimage.label(grid, structure=np.ones((3, 3, 3)))
        label = labels[voxel[:, 0], voxel[:, 1], voxel[:, 2]]
        sizes = np.bincount(label, minlength=count + 1)
        choice = int(sizes.argmax())
        if self._centroid is not None and count > 1:
            sums = np.stack([np.bincount(label, points[:, k], count + 1) for k in range(3)], axis=1)
            centroids = sums / np.maximum(sizes, 1)[:, None]
            near = np.linalg.norm(centroids - self._centroid, axis=1) < 2 * self.settings.cluster_gap
            near &= sizes >= self.settings.min_pixels
            if near.any():
                choice = int(np.where(near, sizes, 0).argmax())
        return np.asarray(label == choice)
