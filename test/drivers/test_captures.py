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

"""Intrinsics from a field of view and from parameters."""

import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.drivers.captures import DeviceSettings, chosen, from_field_of_view
from debris_scanner.drivers.faults import DriverError, Fault

TOLD = Camera(570.0, 571.0, 320.0, 240.0, 640, 480)


def test_field_of_view_of_an_xtion():
    camera = from_field_of_view(640, 480, 1.0225999, 0.79661566)  # as PS1080 devices report it
    assert camera.fx == pytest.approx(570.3, abs=0.1)
    assert camera.fy == pytest.approx(570.3, abs=0.1)
    assert (camera.cx, camera.cy, camera.width, camera.height) == (320, 240, 640, 480)


@pytest.mark.parametrize('fov', [(0, 0), (-1, 1), (4, 1), (float('nan'), 1)])
def test_no_field_of_view(fov):
    assert from_field_of_view(640, 480, *fov) is None


def test_the_device_is_believed_unless_told_otherwise():
    assert chosen(TOLD, 'told', DeviceSettings(), 640, 480) == (TOLD, 'told')


def test_parameters_come_first_value_by_value():
    camera, source = chosen(TOLD, 'told', DeviceSettings(cx=319.5), 640, 480)
    assert camera == Camera(570.0, 571.0, 319.5, 240.0, 640, 480)
    assert source == 'cx given as parameters, else told'
    camera, source = chosen(TOLD, 'told', DeviceSettings(fx=1, fy=2, cx=3, cy=4), 640, 480)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (1, 2, 3, 4)
    assert source == 'given as parameters'


def test_one_focal_length_is_enough():
    camera, source = chosen(None, '', DeviceSettings(fx=285), 320, 240)
    assert camera == Camera(285, 285, 160, 120, 320, 240)
    assert source == 'fx, fy given as parameters, else the middle of the image'


def test_without_any_it_says_what_to_give():
    with pytest.raises(DriverError, match='give fx') as caught:
        chosen(None, '', DeviceSettings(), 320, 240)
    assert caught.value.fault == Fault.INTRINSICS
