"""Normals of an organised depth image by a plane fit in disparity.

A plane is a linear function of the pixel in 1/z, and the sensor's noise is uniform there, so a
least-squares fit over a small window gives normal and smoothed depth in one pass, at a fraction of
the cost of a neighbour search (peer figures: 3 ms against 81 ms by radius search on one core).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from debris_scanner.camera import Camera
from debris_scanner.parameters import parameter


@dataclass(frozen=True)
class NormalSettings:
    """Window of the plane fit."""

    radius: int = parameter(5, 'half width of the fitted window: (2 radius + 1)² pixels', 'px', 1, 20)
    inner_radius: int = parameter(2, 'half width of the window that sets the depth', 'px', 1, 20)
    max_jump: float = parameter(0.015, 'neighbours further away in depth are left out', 'm', 1e-4, 1.0)


def fit_normals(
    depth: NDArray[np.float32], camera: Camera, settings: NormalSettings
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Plane-fitted depth (h, w) in metres and unit normals (h, w, 3) towards the sensor.

    Pixels without depth, or with too few neighbours for a fit, are 0 in both.
    """
    fitted = np.zeros_like(depth)
    normals = np.zeros((*depth.shape, 3), np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    _plane_fit(depth, intrinsics, settings.radius, settings.inner_radius, settings.max_jump, fitted, normals)
    return fitted, normals


@njit(cache=True, fastmath=True, nogil=True)
def _plane_fit(
    depth: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    radius: int,
    inner: int,
    max_jump: float,
    fitted: NDArray[np.float32],
    normals: NDArray[np.float32],
) -> None:
    h, w = depth.shape
    fx, fy, cx, cy = intrinsics
    enough = 12 + radius * radius * 0.5
    for v in range(h):
        for u in range(w):
            z0 = depth[v, u]
            if z0 <= 0:
                continue
            n = sx = sy = sxx = sxy = syy = sq = sxq = syq = 0.0
            for i in range(max(0, v - radius), min(h, v + radius + 1)):
                for j in range(max(0, u - radius), min(w, u + radius + 1)):
                    z = depth[i, j]
                    if z > 0 and abs(z - z0) < max_jump:
                        x, y, q = j - u, i - v, 1.0 / z
                        n += 1
                        sx += x
                        sy += y
                        sxx += x * x
                        sxy += x * y
                        syy += y * y
                        sq += q
                        sxq += x * q
                        syq += y * q
            if n < enough:
                continue
            mx, my, mq = sx / n, sy / n, sq / n
            cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
            cxq, cyq = sxq / n - mx * mq, syq / n - my * mq
            det = cxx * cyy - cxy * cxy
            if det < 0.5:  # the neighbours lie on a line
                continue
            a = (cxq * cyy - cyq * cxy) / det
            b = (cyq * cxx - cxq * cxy) / det
            q0 = mq - a * mx - b * my
            if q0 <= 0:
                continue
            # The wide window rounds ridges, more so where seen obliquely, and that pulls registration
            # after the motion; so the level is taken from the nearest pixels, the slope from all. The
            # pixel itself is left out: its noise must not be in both the point and its anchor.
            n = sq = 0.0
            for i in range(max(0, v - inner), min(h, v + inner + 1)):
                for j in range(max(0, u - inner), min(w, u + inner + 1)):
                    z = depth[i, j]
                    if z > 0 and abs(z - z0) < max_jump and not (i == v and j == u):
                        n += 1
                        sq += 1.0 / z - a * (j - u) - b * (i - v)
            if n > 0:
                q0 = sq / n
            # 1/z = nx' (u-cx)/fx + ny' (v-cy)/fy + nz': the plane's normal up to scale
            nx, ny = a * fx, b * fy
            nz = q0 - a * (u - cx) - b * (v - cy)
            length = (nx * nx + ny * ny + nz * nz) ** 0.5
            fitted[v, u] = 1.0 / q0
            normals[v, u, 0] = -nx / length
            normals[v, u, 1] = -ny / length
            normals[v, u, 2] = -nz / length
