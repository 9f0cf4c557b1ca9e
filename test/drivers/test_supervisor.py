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

"""The supervisor with processes that behave in every way a device's process may."""

import os
import time
from pathlib import Path

import pytest
from devices import HASTY, HERE, Watcher

from debris_scanner.drivers import supervisor
from debris_scanner.drivers.faults import Fault


@pytest.fixture
def pretend(monkeypatch, tmp_path):
    """A device that acts as told, one word a life."""
    monkeypatch.setattr(supervisor, 'MODULE', 'pretend_device')
    monkeypatch.setenv('PYTHONPATH', f'{HERE}:{os.environ.get("PYTHONPATH", "")}')
    acts = tmp_path / 'acts'

    def make(*words):
        acts.write_text(' '.join(words))
        return Watcher('pretend', HASTY, device=str(acts))

    return make


def alive(pid):
    return Path(f'/proc/{pid}').exists()


def test_images_arrive_whole_and_in_order(pretend):
    with pretend('plays') as device:
        device.until(lambda: len(device.captures) == 3, 'three images')
    assert [c.pixels.tolist() for c in device.captures] == [[[k] * 4] * 2 for k in range(3)]
    assert [c.device_ns for c in device.captures] == [0, 10**8, 2 * 10**8]
    assert device.opened[0].camera.fx == 5
    assert device.faults == []


@pytest.mark.parametrize(
    ('word', 'fault', 'said'),
    [
        ('no_device', Fault.DEVICE, 'nothing there'),
        ('crashes', Fault.CRASHED, 'SIGSEGV'),
        ('garbage', Fault.CRASHED, 'exit code 0'),
        ('silent', Fault.SILENT, 'has sent no image'),
        ('deaf', Fault.SILENT, 'has not answered'),
    ],
)
def test_after_a_fault_it_is_said_and_the_device_opened_anew(pretend, word, fault, said):
    with pretend(word, 'plays') as device:
        device.until(lambda: device.faults, 'the fault')
        before = len(device.captures)
        device.until(lambda: len(device.captures) == before + 3, 'images after the fault')
    assert [f.fault for f in device.faults] == [fault]
    assert said in str(device.faults[0])


def test_pauses_grow_while_it_fails_and_are_short_again_after_images(pretend):
    with pretend(*['no_device'] * 4, 'crashes', 'plays') as device:
        device.until(lambda: len(device.captures) == 6, 'images of two lives')
    assert device.pauses == pytest.approx([0.05, 0.1, 0.2, 0.2, 0.05])


def test_end_of_a_recording_is_the_end(pretend):
    with pretend('ends', 'plays') as device:
        assert device.ended.wait(30)
        time.sleep(0.3)
        assert len(device.opened) == 1
    assert device.faults == []


@pytest.mark.parametrize('word', ['plays', 'deaf', 'hangs_at_once'])
def test_stopping_leaves_no_process(pretend, word):
    device = pretend(word)
    with device:
        deadline = time.monotonic() + 30
        while device.supervisor.process_id is None or (word != 'hangs_at_once' and not device.opened):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        pid = device.supervisor.process_id
    assert not alive(pid)


def test_error_of_the_listener_is_raised_where_it_can_be_seen(pretend):
    device = pretend('plays')

    def fail(_capture):
        raise RuntimeError('of the listener')

    object.__setattr__(device.supervisor._listener, 'capture', fail)
    device.supervisor.start()
    device.supervisor._thread.join(30)
    with pytest.raises(RuntimeError, match='of the listener'):
        device.supervisor.check()
