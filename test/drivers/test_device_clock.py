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

"""Stamps from a device's clock: even, monotone, and true to the system's."""

import numpy as np
import pytest

from debris_scanner.drivers.device_clock import DeviceClock, RateLimit, TickCounter

MS = 10**6
START = 1_700_000_000 * 10**9


def test_jitter_of_the_arrival_does_not_reach_the_stamps():
    rng = np.random.default_rng(1)
    clock = DeviceClock()
    device = np.arange(600) * 33_333_333
    drift = 1 + 20e-6  # of the two quartz clocks
    late = 5 * MS + rng.exponential(4 * MS, len(device)).astype(np.int64)
    stamps = [
        clock.stamp_ns(int(d), START + int(d * drift) + int(e)) for d, e in zip(device, late, strict=True)
    ]
    assert all(type(s) is int for s in stamps)
    assert np.all(np.diff(stamps) > 0)
    error = np.array(stamps[30:]) - (START + (device[30:] * drift).astype(np.int64) + 5 * MS)
    assert np.abs(error).max() < 1.5 * MS  # arrivals are up to 30 ms late
    assert np.std(np.diff(stamps[30:])) < 0.5 * MS


@pytest.mark.parametrize('jump_ns', [-10 * 10**9, 3600 * 10**9])
def test_a_recording_that_starts_over_or_a_clock_set_anew(jump_ns):
    clock = DeviceClock()
    before = [clock.stamp_ns(20 * 10**9 + k * 33 * MS, START + k * 33 * MS) for k in range(10)]
    after = [
        clock.stamp_ns(20 * 10**9 + jump_ns + k * 33 * MS, START + (10 + k) * 33 * MS) for k in range(10)
    ]
    assert np.allclose(np.diff(before + after), 33 * MS, atol=MS)


def test_a_hiccup_of_the_system_does_not_shift_the_stamps():
    clock = DeviceClock()
    late = [0] * 10 + [400 * MS, 370 * MS, 340 * MS] + [0] * 10
    stamps = [clock.stamp_ns(k * 33 * MS, START + k * 33 * MS + e) for k, e in enumerate(late)]
    assert np.all(np.diff(stamps) == 33 * MS)


def test_system_clock_set_forward_is_followed_soon():
    clock = DeviceClock()
    stamps = [clock.stamp_ns(k * 33 * MS, START + k * 33 * MS + (k >= 5) * 10**12) for k in range(30)]
    assert np.all(np.diff(stamps) > 0)
    assert stamps[-1] == START + 29 * 33 * MS + 10**12


def test_a_player_that_falls_behind_leaves_the_recording_its_times():
    clock = DeviceClock(recorded=True)
    stamps = [clock.stamp_ns(k * 100 * MS, START + k * 150 * MS) for k in range(400)]
    assert np.all(np.diff(stamps) == 100 * MS)
    again = clock.stamp_ns(0, START + 400 * 150 * MS)
    assert again == START + 400 * 150 * MS


def test_system_clock_set_back_is_followed():
    clock = DeviceClock()
    clock.stamp_ns(0, START)
    assert clock.stamp_ns(33 * MS, START - 3600 * 10**9) == START - 3600 * 10**9


def test_ticks_wrap_around():
    counter = TickCounter(60_000_000)
    ticks = [(2**32 - 3_000_000 + k * 2_000_000) % 2**32 for k in range(5)]
    times = [counter.ns(t) for t in ticks]
    assert np.allclose(np.diff(times), 1e9 / 30, atol=1)
    assert counter.ns(ticks[3]) == times[3]  # colour may be a little older than the depth before it


@pytest.mark.parametrize(
    ('device_hz', 'asked', 'got'), [(30, 15, 15), (30, 30, 30), (30, 10, 10), (30, 100, 30), (30, 12, 12)]
)
def test_rate_is_bounded_and_even(device_hz, asked, got):
    rng = np.random.default_rng(2)
    limit = RateLimit(asked)
    times = (np.arange(20 * device_hz) / device_hz * 1e9 + rng.normal(0, 5e5, 20 * device_hz)).astype(
        np.int64
    )
    passed = [int(t) for t in times if limit.passes(int(t))]
    assert len(passed) == pytest.approx(20 * got, abs=2)
    assert np.diff(passed).max() < 1.7e9 / got


def test_rate_limit_goes_on_after_a_jump_of_the_clock():
    limit = RateLimit(10)
    for start in (10**12, 5, 10**15):
        assert [limit.passes(start + k * 10**8) for k in range(3)] == [True] * 3
