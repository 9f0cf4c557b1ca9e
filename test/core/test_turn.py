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

"""How much of a turn was shown: to and fro and noise do not add up, target frames do not matter."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.turn import MOST_KEPT, TurnWatch, turn_words

AXIS = np.array([0.3, -0.8, 0.52])
AXIS = AXIS / np.linalg.norm(AXIS)


def attitudes(degrees, seed=0, noise_deg=0.3):
    """R_sensor_target (n, 3, 3) of a target turned by these angles about one axis, with noise."""
    rng = np.random.default_rng(seed)
    start = exp_so3(np.array([0.4, 0.2, -1.0]))
    noise = np.radians(noise_deg) * rng.normal(size=(len(degrees), 3))
    return np.array(
        [exp_so3(n) @ exp_so3(AXIS * np.radians(a)) @ start for n, a in zip(noise, degrees, strict=True)]
    )


def shown_deg(seen):
    watch = TurnWatch()
    for R in seen:
        watch.add('scan', R)
    return np.degrees(watch.shown)


@pytest.mark.parametrize('whole', [40, 220, 359, 500])
def test_an_even_turn_is_measured(whole):
    assert shown_deg(attitudes(np.linspace(0, whole, 150))) == pytest.approx(whole, abs=3)


def test_to_and_fro_does_not_add_up():
    swings = 30 * np.sin(np.linspace(0, 12 * np.pi, 400))
    assert shown_deg(attitudes(swings)) == pytest.approx(60, abs=4)


def test_a_still_target_and_few_frames_show_no_turn():
    assert shown_deg(attitudes(np.zeros(300))) < 4
    assert shown_deg(attitudes([0.0])) == shown_deg([]) == 0.0


def test_words():
    assert turn_words(np.radians(219.8)) == 'turn on: 220° of 360° seen'
    assert turn_words(np.radians(359.9)) == 'turn on: 359° of 360° seen'
    assert turn_words(np.radians(360.1)) == 'a whole turn seen'


def test_watching_gives_the_same_and_goes_on_in_another_target_frame():
    seen = attitudes(np.linspace(0, 200, 100))
    watch = TurnWatch()
    assert watch.shown == 0.0
    for k, R in enumerate(seen):
        watch.add('model' if k > 60 else 'scan', R @ exp_so3(np.array([0, 2.0, 0])) if k > 60 else R)
    assert np.degrees(watch.shown) == pytest.approx(200, abs=8)  # a step is lost at the change


def test_a_target_that_rocks_for_ever_fills_no_memory():
    watch = TurnWatch()
    for R in np.tile(attitudes([0.0, 20.0]), (MOST_KEPT, 1, 1)):
        watch.add('scan', R)
    assert len(watch._kept) == MOST_KEPT
    assert np.degrees(watch.shown) == pytest.approx(20, abs=2)
