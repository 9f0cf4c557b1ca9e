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

"""Recordings that fakenect would abort on are found out first."""

import numpy as np
import pytest
from recordings import write_fakenect

from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.drivers.freenect_device import check_recording


@pytest.fixture
def folder(tmp_path):
    depth = np.full((480, 640), 800, np.uint16)
    return write_fakenect(tmp_path / 'kinect', [depth] * 3, 10, [np.zeros((480, 640, 3))])


def test_good_recording(folder):
    assert check_recording(folder) == 3


def test_accelerometer_is_let_pass(folder):
    (folder / 'a-1000.5-7.dump').write_bytes(b'12345678')
    index = folder / 'INDEX.txt'
    index.write_text(index.read_text() + 'a-1000.5-7.dump\n')
    assert check_recording(folder) == 3


def first(folder):
    return folder / (folder / 'INDEX.txt').read_text().splitlines()[0]


@pytest.mark.parametrize(
    ('spoil', 'said'),
    [
        (lambda f: (f / 'INDEX.txt').unlink(), 'No such file'),
        (lambda f: (f / 'INDEX.txt').write_text(''), 'empty or cut off'),
        (lambda f: (f / 'INDEX.txt').write_text(first(f).name), 'empty or cut off'),
        (lambda f: (f / 'INDEX.txt').write_text(f'{first(f).name}\n\n{first(f).name}\n'), 'empty line'),
        (lambda f: (f / 'INDEX.txt').write_text('../INDEX.txt\n'), 'not in its folder'),
        (lambda f: (f / 'INDEX.txt').write_text('r-1000.000000-1.ppm\n'), 'No such file'),
        (lambda f: first(f).unlink(), 'No such file'),
        (lambda f: first(f).write_bytes(first(f).read_bytes()[:-1]), 'not an image'),
        (lambda f: first(f).write_bytes(b'no header'), 'not an image'),
    ],
)
def test_spoiled_recording(folder, spoil, said):
    spoil(folder)
    with pytest.raises(DriverError, match=said) as caught:
        check_recording(folder)
    assert caught.value.fault == Fault.RECORDING
