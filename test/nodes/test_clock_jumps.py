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

"""A clock that is set in the middle of a recording: the scan goes on, and no gap takes long."""

import json
import signal
import time

import pytest
from altered_bags import altered

from debris_scanner.cli.main import main
from debris_scanner.core.frames import DepthFrame
from debris_scanner.scanner import Scanner
from msg_adapters.bags import open_session

S = 10**9
HOUR, YEARS = 3600, 50 * 31_557_600
FIRST, FRAMES = 8, 16  # the jump is before this frame; so many are kept


def jumped(bag, path, jump_s, stamps, bags_time):
    """A recording whose stamps, bag's time or both jump; it begins so late that they can go back."""
    start_s = 7200 + max(0, -jump_s)

    def change(k):
        after = jump_s if k >= FIRST else 0
        moved = ((start_s + after * one) * S for one in (bags_time, stamps))
        return tuple(moved) if k < FRAMES else None

    return altered(bag, path, change)


@pytest.mark.parametrize(('stamps', 'bags_time'), [(1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize('jump_s', [HOUR, YEARS, -HOUR, -YEARS])
def test_a_clock_that_is_set_costs_two_frames_and_no_time(tmp_path, brief_bag, jump_s, stamps, bags_time):
    scanner, longest_s, step = Scanner(), 0.0, None
    with open_session(jumped(brief_bag, tmp_path / 'bag', jump_s, stamps, bags_time)) as session:
        for _, frame in session:
            assert isinstance(frame, DepthFrame)
            began_s = time.process_time()
            step = scanner.process(frame)
            longest_s = max(longest_s, time.process_time() - began_s)
    # where the bag's time goes back, the later half comes first, and the earlier one is not what comes next
    assert scanner.back_end.recorder.used >= FRAMES - (4 if bags_time and jump_s < 0 else 2)
    assert step.estimate is not None and step.estimate.accepted
    assert longest_s < 5.0  # it took minutes for a day, and days for years
    assert not scanner.faults.counts


def test_ctrl_c_at_the_jump_ends_the_scan_with_that_frame(tmp_path, brief_bag, monkeypatch):
    bag, process, calls = jumped(brief_bag, tmp_path / 'bag', YEARS, 1, 1), Scanner.process, []

    def interrupted(scanner, frame):
        calls.append(frame)
        if len(calls) == FIRST + 1:
            signal.raise_signal(signal.SIGINT)
        return process(scanner, frame)

    monkeypatch.setattr(Scanner, 'process', interrupted)
    assert main(['scan', str(bag), '--out', str(tmp_path / 'out')]) == 3
    told = json.loads((tmp_path / 'out' / 'summary.json').read_bytes())
    assert (told['reason'], told['frames']['read']) == ('interrupted', FIRST + 1)
