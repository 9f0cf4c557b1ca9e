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

"""What the bus says of a camera that no library opens."""

import os

import pytest

from debris_scanner.drivers import usb_access
from debris_scanner.drivers.faults import Fault


@pytest.fixture
def bus(tmp_path):
    """A Xtion, a mouse and an interface on a made-up bus."""
    for name, vendor, product in (('1-1', '1d27', '0601'), ('1-2', '046d', 'c077')):
        folder = tmp_path / 'sys' / name
        folder.mkdir(parents=True)
        for file, text in (('idVendor', vendor), ('idProduct', product), ('busnum', '1'), ('devnum', '7')):
            (folder / file).write_text(f'{text}\n')
    (tmp_path / 'sys' / '1-1:1.0').mkdir()
    node = tmp_path / 'dev' / '001' / '007'
    node.parent.mkdir(parents=True)
    node.touch()
    return tmp_path


def found(bus):
    return usb_access.cameras(usb_access.OPENNI2_VENDORS, usb_access.KINECT, bus / 'sys', bus / 'dev')


def test_only_cameras_are_found(bus):
    (device,) = found(bus)
    assert (device.vendor, device.product, device.node) == ('1d27', '0601', bus / 'dev' / '001' / '007')


def test_nothing_plugged_in(tmp_path):
    error = usb_access.missing(found(tmp_path), 'camera')
    assert error.fault == Fault.DEVICE
    assert 'no camera is plugged in' in str(error)


def test_no_permission_says_the_rule(bus, monkeypatch):
    monkeypatch.setattr(os, 'access', lambda path, mode: False)
    error = usb_access.missing(found(bus), 'camera')
    assert error.fault == Fault.PERMISSION
    assert 'SUBSYSTEM=="usb", ATTR{idVendor}=="1d27", ATTR{idProduct}=="0601", MODE="0666"' in error.advice


def test_container_without_the_device(bus):
    (bus / 'dev' / '001' / '007').unlink()
    error = usb_access.missing(found(bus), 'camera')
    assert error.fault == Fault.PERMISSION
    assert '--device=/dev/bus/usb' in error.advice


def test_in_use(bus):
    assert 'another program' in str(usb_access.missing(found(bus), 'camera'))
