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

"""Earlier key frames of a turn with given probabilities of closure, as the searches take them."""

import numpy as np

STEP = np.radians(10.0)  # between key frames
SECOND = 1_000_000_000


def turn(probabilities):
    """Arrays of earlier key frames with these probabilities, ten degrees apart, and the newest one's path."""
    p = np.asarray(probabilities, float)
    n = len(p)
    return np.arange(n, dtype=np.int64) * SECOND, p, np.arange(n) * STEP, n * STEP


def indices(found):
    return [c.index for c in found]


def full_turn():
    """36 earlier frames: alike at the start of the turn, in its middle, and just now."""
    p = np.full(36, 0.3)
    p[[0, 1, 2]] = 0.95, 0.9, 0.82
    p[[16, 17, 18, 19, 20]] = 0.85, 0.97, 0.98, 0.97, 0.85
    p[[30, 32, 33, 34, 35]] = 0.9, 0.9, 0.7, 0.99, 0.99
    return turn(p)
