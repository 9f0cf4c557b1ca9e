"""Views of the target, prepared for registration: sampled surface, maps, silhouette."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array

SAMPLE_STRIDE = 3  # pixels between the points that are registered
MIN_INCIDENCE_COS = 0.2  # surfaces seen more obliquely are not sampled


@dataclass
class Surface:
    """Points (n, 3) and unit normals (n, 3), float32, of a view or a model, in its own frame.

    ``anchors`` are the same points with less noise, where there are such: they are projected and serve as
    lever arms. Were it the measured points, their noise would enter both the residual and, by the pixel
    looked up and the lever arm, its derivative; every estimated rotation would come out some per cent
    short. ``rim`` holds the points that must project inside another view's silhouette: a view's own rim,
    any point of a model.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    anchors: NDArray[np.float32]
    rim: NDArray[np.float32]


class View(Surface):
    """A target frame prepared for registration: sampled surface, maps, and silhouette distance field."""

    def __init__(self, frame: TargetFrame) -> None:
        camera = frame.camera
        self.frame = frame
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.depth_fit = frame.depth_fit
        self.normal_map = frame.normals
        step = slice(None, None, SAMPLE_STRIDE)
        z = frame.depth[step, step]
        normals = frame.normals[step, step]
        v, u = np.nonzero((z > 0) & (frame.depth_fit[step, step] > 0))
        points = _back_project(v * SAMPLE_STRIDE, u * SAMPLE_STRIDE, z[v, u], self.intrinsics)
        n = normals[v, u]
        incidence = -(n * points).sum(axis=1) / np.linalg.norm(points, axis=1)
        keep = incidence > MIN_INCIDENCE_COS
        anchors = points * (frame.depth_fit[step, step][v, u] / z[v, u])[:, None]
        mask = frame.depth > 0
        closed = ndimage.binary_closing(mask, np.ones((3, 3), bool), 2)
        distance, nearest = ndimage.distance_transform_edt(~closed, return_indices=True)
        self.mask_distance = distance.astype(np.float32)  # px to the silhouette, 0 inside
        rows, columns = np.indices(mask.shape, dtype=np.float32)
        away = np.stack([columns - nearest[1], rows - nearest[0]], axis=-1)
        self.mask_gradient = (away / np.maximum(distance, 1e-6)[..., None]).astype(np.float32)
        v, u = np.nonzero(mask & ~ndimage.binary_erosion(closed, np.ones((3, 3), bool)))
        rim = _back_project(v[::2], u[::2], frame.depth[v[::2], u[::2]], self.intrinsics)
        super().__init__(points[keep], np.ascontiguousarray(n[keep]), anchors[keep], rim)

    @property
    def centroid(self) -> Array:
        """Mean of the sampled points (3,), view frame, metres."""
        return np.asarray(self.points.mean(axis=0), dtype=np.float64)


def _back_project(
    v: NDArray[np.intp], u: NDArray[np.intp], z: NDArray[np.float32], intrinsics: Array
) -> NDArray[np.float32]:
    fx, fy, cx, cy = intrinsics
    return np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1).astype(np.float32)
