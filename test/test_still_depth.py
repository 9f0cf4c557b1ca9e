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

"""What stands still shows it within about a second, noise or not, and is known again once uncovered."""

import dataclasses

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.isolation import CONFIRMED_S, StillDepth

CAMERA = Camera(525.0, 525.0, 20.0, 15.0, 40, 30)
ROWS, COLUMNS = (a.ravel().astype(np.int32) for a in np.indices((30, 40)))
STEP_NS = 100_000_000


def observe(still, k, depth, camera=CAMERA):
    return still.observe(
        camera, (k + 1) * STEP_NS, ROWS, COLUMNS, np.broadcast_to(depth, ROWS.shape).astype(float)
    )


def test_a_noisy_wall_stands_still_after_about_a_second():
    rng, still = np.random.default_rng(0), StillDepth()
    shares = [observe(still, k, 1.0 + rng.normal(0, 0.0022, ROWS.size)).mean() for k in range(25)]
    assert max(shares[: int(CONFIRMED_S * 10) - 1]) == 0
    assert shares[-1] > 0.95
    assert still.observed_s > 2


def test_what_moves_never_does():
    still = StillDepth()
    for k in range(40):
        assert not observe(still, k, 0.8 + 0.05 * np.sin(0.9 * k)).any()


def test_it_is_known_again_after_something_passed_in_front():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0)
    assert not observe(still, 15, 0.7).any()
    assert not observe(still, 16, 0.74).any()
    assert observe(still, 17, 1.0).all()


def test_another_camera_starts_anew():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0)
    other = Camera(525.0, 525.0, 19.0, 15.0, 40, 30)
    assert not still.observe(other, 16 * STEP_NS, ROWS, COLUMNS, np.ones(ROWS.size)).any()
    assert still.observed_s == 0


def test_a_camera_fitted_to_each_cloud_is_the_same_camera():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0, dataclasses.replace(CAMERA, fx=525 + 1e-6 * k, cx=20 - 1e-7 * k))
    assert observe(still, 15, 1.0).all()
    assert not observe(still, 16, 1.0, dataclasses.replace(CAMERA, fx=570.0, fy=570.0)).any()
