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

"""A detector's box chooses the target; masks are tried over DDS."""

from types import SimpleNamespace

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.masks import masked


def box(u, v, width, height, theta=0.0):
    """What is read of a vision_msgs/Detection2D, which has no wheel."""
    centre = SimpleNamespace(position=SimpleNamespace(x=u, y=v), theta=theta)
    return SimpleNamespace(bbox=SimpleNamespace(center=centre, size_x=width, size_y=height))


def test_the_box_of_a_detector_chooses_the_target():
    frame = DepthFrame(1, np.ones((20, 30), np.float32), Camera(40.0, 40.0, 14.5, 9.5, 30, 20))
    chosen = masked(frame, box(10.0, 8.0, 4.0, 6.0)).depth > 0
    assert np.argwhere(chosen).min(axis=0).tolist() == [5, 8]
    assert np.argwhere(chosen).max(axis=0).tolist() == [11, 12]
    turned = masked(frame, box(10.0, 8.0, 4.0, 6.0, np.pi / 2)).depth > 0
    assert turned[6:11, 7:14].all() and turned.sum() == 35
    assert not masked(frame, box(-50.0, 8.0, 4.0, 6.0)).depth.any()
    for wrong in (box(10.0, 8.0, 0.0, 6.0), box(10.0, 8.0, 4.0, -1.0), box(np.nan, 8.0, 4.0, 6.0)):
        with pytest.raises(MalformedMessage, match='the box has sides'):
            masked(frame, wrong)
