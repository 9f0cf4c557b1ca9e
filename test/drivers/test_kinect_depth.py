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

"""Raw disparity to depth, against libfreenect's own arithmetic."""

import numpy as np
import pytest
from recordings import raw_disparity

from debris_scanner.drivers.kinect_depth import MAX_MM, NO_RAW, ZeroPlane

PLANES = [ZeroPlane(), ZeroPlane(7.4, 118.0, 0.1, 199.5)]


def raw_to_mm(raw, plane):
    """As freenect_raw_to_mm computes it, before it cuts off the fraction."""
    fixed_ref_x = ((raw - (4 * plane.const_shift_px / 1)) / 4) - 0.375
    metric = fixed_ref_x * plane.pixel_mm * 1
    return 10 * ((metric * plane.focal_mm / (plane.emitter_cm - metric)) + plane.focal_mm)


@pytest.mark.parametrize('plane', PLANES)
def test_table_is_libfreenects_rounded(plane):
    table = plane.table_mm()
    assert table.dtype == np.uint16
    assert table[NO_RAW] == 0
    assert 300 < table[table > 0][0] < 500
    for raw in np.flatnonzero(table):
        assert abs(table[raw] - raw_to_mm(int(raw), plane)) <= 0.5 + 1e-9
    known = table[table > 0]
    assert known.max() < MAX_MM
    assert np.all(np.diff(known.astype(int)) >= 0)


def test_known_value_of_a_typical_kinect():
    assert ZeroPlane().table_mm()[596] == pytest.approx(700, abs=2)


def test_focal_length_of_the_infrared_camera():
    camera = ZeroPlane().camera
    assert camera.fx == camera.fy == pytest.approx(575.8, abs=0.05)
    assert (camera.cx, camera.cy) == (320, 240)


@pytest.mark.parametrize('plane', PLANES)
def test_disparity_of_the_tests_is_the_inverse_up_to_its_step(plane):
    depth = np.arange(450, 1300, dtype=np.uint16)
    back = plane.table_mm()[raw_disparity(depth, plane)].astype(int)
    step = depth.astype(float) ** 2 / 1000 * 3.1e-3  # an eighth of a pixel at this distance, millimetres
    assert np.all(np.abs(back - depth) <= step / 2 + 1)
    assert raw_disparity(np.zeros(3, np.uint16), plane).tolist() == [NO_RAW] * 3
