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

"""What a scan's sensor does, measured on neighbouring key frames: its noise, and what it returns at all."""

from dataclasses import replace

import numpy as np

from debris_scanner.core.geometry import compose, inverse
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.likelihood import BeamModel, pair_likelihood
from debris_scanner.registration.projective import register
from debris_scanner.sensing.sensor_model import Pair, SensorModel, measure_sensor

PAIRS = 8
ROUNDS = 2  # of expectation maximisation


def sensor_evidence(keyframes: KeyFrameSet) -> SensorModel | None:
    """The sensor as registered neighbours show it, or None if there are none.

    Neighbours are some degrees apart and right in any scan, also in one whose loop was closed wrongly.
    """
    linked = [k for k in keyframes.active[1:] if keyframes.frames[k].linked]
    pairs: list[Pair] = []
    for n in np.unique(np.linspace(0, len(linked) - 1, min(len(linked), PAIRS)).astype(int)):
        k = linked[int(n)]
        T, T_before = keyframes.frames[k].T_target_sensor, keyframes.frames[k - 1].T_target_sensor
        found = register(keyframes.views[k], T, keyframes.views[k - 1], T_before)
        if found is not None:
            pairs.append((keyframes.views[k], compose(inverse(T_before), found[0]), keyframes.views[k - 1]))
    sensor = measure_sensor(pairs)
    if sensor is None:
        return None
    beam = BeamModel.of(sensor, [view for view, _, _ in pairs])
    for _ in range(ROUNDS):
        beam = beam.with_shares_of(
            pair_likelihood(view, T_other_view, other, np.eye(4), beam, np.zeros(3))
            for view, T_other_view, other in pairs
        )
    return replace(sensor, shares=tuple(tuple(float(s) for s in row) for row in beam.shares))
