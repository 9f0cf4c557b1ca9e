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

"""Messages through the pipe: whole, whatever the pieces they come in."""

import os
import threading

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.drivers import channel
from debris_scanner.drivers.captures import COLOUR, DEPTH, Capture, DeviceInfo
from debris_scanner.drivers.channel import Receiver, Sender
from debris_scanner.drivers.faults import DriverError, Fault


@pytest.fixture
def ends():
    ours, theirs = os.pipe()
    receiver = Receiver(ours)
    yield Sender(theirs), receiver
    receiver.close()


def test_every_kind_of_message_arrives_as_it_was_sent(ends):
    sender, receiver = ends
    camera = Camera(575.8, 575.8, 320, 240, 640, 480)
    info = DeviceInfo('a Kinect', camera, 'told', True, False, camera)
    depth = Capture(DEPTH, np.arange(12, dtype=np.uint16).reshape(3, 4), 5, 7)
    metres = Capture(DEPTH, np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4), 5, 7)
    colour = Capture(COLOUR, np.zeros((3, 4, 3), np.uint8)[:, ::-1], 2**62, 2**62)
    sender.opened(info)
    for capture in (depth, metres, colour):
        sender.capture(capture)
    sender.alive()
    sender.fault(DriverError(Fault.PERMISSION, 'no', 'do this'))
    sender.end()
    assert receiver.read(1) == (channel.OPENED, info)
    for capture in (depth, metres, colour):
        kind, got = receiver.read(1)
        assert kind == channel.CAPTURE
        assert (got.stream, got.device_ns, got.arrival_ns) == (
            capture.stream,
            capture.device_ns,
            capture.arrival_ns,
        )
        assert got.pixels.dtype == capture.pixels.dtype
        assert np.array_equal(got.pixels, capture.pixels)
    assert receiver.read(1) == (channel.ALIVE, None)
    kind, error = receiver.read(1)
    assert (kind, error.fault, str(error)) == (channel.FAULT, Fault.PERMISSION, 'no permission: no; do this')
    assert receiver.read(1) == (channel.END, None)
    assert receiver.read(0.01) is None


def test_an_image_larger_than_the_pipe(ends):
    sender, receiver = ends
    pixels = np.random.default_rng(0).integers(0, 2**16, (1024, 1280), np.uint16)
    thread = threading.Thread(target=sender.capture, args=(Capture(DEPTH, pixels, 1, 2),))
    thread.start()
    _, got = receiver.read(10)
    thread.join()
    assert np.array_equal(got.pixels, pixels)


def test_the_other_end_has_gone():
    ours, theirs = os.pipe()
    receiver = Receiver(ours)
    os.write(theirs, b'\x02')
    os.close(theirs)
    with pytest.raises(EOFError):
        receiver.read(1)
    receiver.close()


def test_what_is_no_message():
    ours, theirs = os.pipe()
    receiver = Receiver(ours)
    os.write(theirs, b'\xff' * 100)
    with pytest.raises(ValueError, match='not a message'):
        receiver.read(1)
    os.close(theirs)
    receiver.close()
