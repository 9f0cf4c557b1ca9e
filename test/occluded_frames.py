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

"""Recorded frames of which something hides a part."""

import numpy as np

from debris_scanner.core.frames import TargetFrame


def shaded(target, share):
    """The frame with a part of the target, from the top, behind a straight shadow's edge."""
    depth, fitted, normals = target.depth.copy(), target.depth_fit.copy(), target.normals.copy()
    rows = np.nonzero(depth.any(axis=1))[0]
    dark = rows[0] + round(share * len(rows))
    depth[:dark], fitted[:dark], normals[:dark] = 0, 0, 0
    return TargetFrame(target.stamp_ns, target.camera, depth, fitted, normals)
