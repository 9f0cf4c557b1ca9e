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

"""What a sensor would see of a mesh: frames without noise, to compare with real ones."""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.open3d_library import load_open3d


class MeshImages:
    """Renders a mesh: vertices (m, 3) in metres, target frame, and triangles (t, 3), outward.

    ``known`` (t,) tells which triangles are surface; others are what fills a gap. These belong to the
    silhouette, and say nothing of the surface: no plane is fitted there. So do triangles seen from inside.
    With colours ``rgb`` (m, 3) of the vertices the frames have an image.
    """

    def __init__(
        self,
        vertices: NDArray[np.floating],
        triangles: NDArray[np.integer],
        known: NDArray[np.bool_] | None = None,
        rgb: NDArray[np.uint8] | None = None,
    ) -> None:
        self._o3d = load_open3d()
        self._corner_rgb = None if rgb is None else rgb[triangles].astype(np.float32)
        self._known = np.ones(len(triangles), bool) if known is None else known
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    @property
    def coloured(self) -> bool:
        """Whether frames have an image."""
        return self._corner_rgb is not None

    def frame(self, camera: Camera, T_sensor_target: Array, stamp_ns: int = 0) -> TargetFrame:
        """The mesh at a pose (4, 4), seen by a camera; flat faces, so that the fitted depth is the depth."""
        u = (np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
        v = (np.arange(camera.height, dtype=np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
        sight = np.ones((camera.height, camera.width, 3), np.float32)
        sight[..., 0], sight[..., 1] = u[None, :], v[:, None]
        R, t = T_sensor_target[:3, :3].astype(np.float32), T_sensor_target[:3, 3].astype(np.float32)
        rays = np.empty((*sight.shape[:2], 6), np.float32)
        rays[..., :3], rays[..., 3:] = -R.T @ t, sight @ R
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays), nthreads=1)
        z = hit['t_hit'].numpy()
        met = np.isfinite(z)
        normals = hit['primitive_normals'].numpy() @ R.T
        outside = np.einsum('ijk,ijk->ij', normals, sight) < 0
        surface = met & outside
        faces = hit['primitive_ids'].numpy()[met]
        surface[met] &= self._known[faces]
        rgb = None
        if self._corner_rgb is not None:
            of_b, of_c = hit['primitive_uvs'].numpy()[met].T
            shares = np.stack([1 - of_b - of_c, of_b, of_c], axis=1)
            rgb = np.zeros((*met.shape, 3), np.uint8)
            rgb[met] = np.rint(np.einsum('nk,nki->ni', shares, self._corner_rgb[faces]))
        depth = np.where(met, z, 0).astype(np.float32)
        return TargetFrame(
            stamp_ns,
            camera,
            depth,
            np.where(surface, depth, np.float32(0)),
            np.where(surface[..., None], normals, 0).astype(np.float32),
            rgb,
        )
