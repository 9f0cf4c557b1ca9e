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

"""Whether a depth camera is plugged in and this user may use it: the libraries do not report that."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from debris_scanner.drivers.faults import DriverError, Fault

SYSFS, DEV = Path('/sys/bus/usb/devices'), Path('/dev/bus/usb')

KINECT = frozenset({('045e', '02ae')})  # its camera; motor and audio are devices of their own
# PrimeSense, whose number the ASUS Xtion carries too: devices of OpenNI2's own drivers.
OPENNI2_VENDORS = frozenset({'1d27'})


@dataclass(frozen=True)
class UsbDevice:
    """A device on the bus."""

    vendor: str  # four hexadecimal digits
    product: str
    node: Path  # that programs open

    @property
    def rule(self) -> str:
        """The udev rule that lets every user use it."""
        return (
            f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{self.vendor}", ATTR{{idProduct}}=="{self.product}", '
            'MODE="0666"'
        )


def cameras(
    vendors: frozenset[str], products: frozenset[tuple[str, str]], sysfs: Path = SYSFS, dev: Path = DEV
) -> Iterator[UsbDevice]:
    """Devices on the bus of these vendors, or of these vendor and product numbers."""
    for folder in sorted(sysfs.glob('*')):
        try:
            vendor, product, bus, number = (
                (folder / name).read_text().strip() for name in ('idVendor', 'idProduct', 'busnum', 'devnum')
            )
        except OSError:  # an interface, or gone meanwhile
            continue
        if vendor in vendors or (vendor, product) in products:
            yield UsbDevice(vendor, product, dev / f'{int(bus):03d}' / f'{int(number):03d}')


def forbidden(name: str, device: UsbDevice) -> DriverError:
    """Fault of a device that this user may not use; ``name`` identifies it."""
    return DriverError(
        Fault.PERMISSION,
        f'{name} may not be used by this user',
        f"put this line into /etc/udev/rules.d/60-depth-camera.rules: '{device.rule}', then "
        'sudo udevadm control --reload && sudo udevadm trigger',
    )


def missing(found: Iterator[UsbDevice], what: str) -> DriverError:
    """Why no device could be opened.

    Args:
        found: on the bus.
        what: the kind of device, in words.
    """
    for device in found:
        name = f'{device.vendor}:{device.product} at {device.node}'
        if not device.node.exists():
            return DriverError(
                Fault.PERMISSION,
                f'{name} is plugged in but not visible here',
                'let the container see it: docker run --device=/dev/bus/usb',
            )
        if not os.access(device.node, os.R_OK | os.W_OK):
            return forbidden(name, device)
        return DriverError(
            Fault.DEVICE, f'{name} is plugged in but cannot be opened', 'does another program use it?'
        )
    return DriverError(Fault.DEVICE, f'no {what} is plugged in', 'plug it in; it is looked for again')
