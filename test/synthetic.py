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

"""Exactly known views: spheres and planes seen by a small camera, without noise or mesh."""

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, TargetFrame
from debris_scanner.sensing.normals import NormalSettings, fit_normals

CAMERA = Camera(262.5, 262.5, 79.5, 59.5, 160, 120)


def rays(camera=CAMERA):
    """Direction (h, w, 3) of every pixel, z = 1."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def sphere_depth(centre=(0.0, 0.0, 0.6), radius=0.1, camera=CAMERA):
    """Depth (h, w) float32 of a sphere, 0 beside it."""
    d, c = rays(camera), np.asarray(centre, float)
    a, b = (d * d).sum(-1), d @ c
    root = b * b - a * (c @ c - radius * radius)
    t = (b - np.sqrt(np.maximum(root, 0))) / a
    return np.where(root > 0, t, 0).astype(np.float32)


def plane_depth(normal, distance, camera=CAMERA):
    """Depth (h, w) float32 of the plane normal . x = -distance, the normal (3,) towards the sensor."""
    return (-distance / (rays(camera) @ np.asarray(normal, float))).astype(np.float32)


def target_frame(depth, stamp_ns=0, camera=CAMERA, rgb=None, settings=None):
    """The whole image as a target frame."""
    fitted, normals = fit_normals(depth, camera, settings or NormalSettings())
    return TargetFrame(stamp_ns, camera, depth, fitted, normals, rgb)


def depth_frame(depth, stamp_ns=0, camera=CAMERA):
    """The image as the sensor sends it."""
    return DepthFrame(stamp_ns, depth, camera)
