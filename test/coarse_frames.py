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

"""Recorded frames as a sensor with fewer pixels would have seen them: a scan of them costs a third."""

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame

STEP = 2


def coarse(frame):
    """The frame with every second pixel of every second row."""
    c = frame.camera
    camera = Camera(c.fx / STEP, c.fy / STEP, c.cx / STEP, c.cy / STEP, c.width // STEP, c.height // STEP)
    return DepthFrame(frame.stamp_ns, np.ascontiguousarray(frame.depth[::STEP, ::STEP]), camera)
