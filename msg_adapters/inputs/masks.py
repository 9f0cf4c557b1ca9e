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

"""What chooses the target in a frame: a mask, or a detector's box."""

import dataclasses
from typing import Any

import numpy as np

from debris_scanner.core.frames import DepthFrame
from msg_adapters.colour_images import read_colour
from msg_adapters.errors import MalformedMessage


def masked(frame: DepthFrame, mask: Any) -> DepthFrame:
    """The frame with depth where a mask (Image mono8) is not 0, or in the box of a Detection2D.

    Raises:
        MalformedMessage: it is no mask, or not one of this frame's pixels.
    """
    if hasattr(mask, 'bbox'):
        return _boxed(frame, mask.bbox)
    chosen = read_colour(mask)[..., 0] > 0
    if chosen.shape != frame.depth.shape:
        height, width = frame.depth.shape
        said = f'the mask has {mask.width}x{mask.height} pixels, depth has {width}x{height}'
        raise MalformedMessage(said)
    return dataclasses.replace(frame, depth=np.where(chosen, frame.depth, np.float32(0)))


def _boxed(frame: DepthFrame, box: Any) -> DepthFrame:
    """The frame with depth in a BoundingBox2D, pixels; turned by ``theta`` about its centre."""
    sides = np.array([box.size_x, box.size_y])
    pose = np.array([box.center.position.x, box.center.position.y, box.center.theta])
    if not (np.isfinite(sides).all() and np.isfinite(pose).all() and (sides > 0).all()):
        raise MalformedMessage(f'the box has sides of {sides[0]:g} and {sides[1]:g} pixels')
    v, u = np.indices(frame.depth.shape)
    du, dv, cosine, sine = u - pose[0], v - pose[1], np.cos(pose[2]), np.sin(pose[2])
    along, across = cosine * du + sine * dv, cosine * dv - sine * du
    inside = (np.abs(along) <= sides[0] / 2) & (np.abs(across) <= sides[1] / 2)
    return dataclasses.replace(frame, depth=np.where(inside, frame.depth, np.float32(0)))
