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

"""Two turns of a target that is another one in the second turn."""

from itertools import islice

from benchmarks import adversaries
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings

TWO_TURNS = SimulationSettings(spin_rad_s=1.0, rate_hz=6.0, seconds=12.5, seed=5)
HALF = round(TWO_TURNS.seconds * TWO_TURNS.rate_hz) // 2


def with_knob(target):
    """50 mm in all directions, on the flank."""
    return adversaries.with_knob(target, 2.0)


def stretched(target):
    """By 4 % along one axis."""
    return adversaries.stretched(target, 4 / 3)


def frames(second):
    """Depth frames of two turns and their true poses; of the second turn the target may be another."""
    first = Simulation(TWO_TURNS)
    later = first if second is None else Simulation(TWO_TURNS, second(first.target))
    for k in range(2 * HALF):
        frame = (first if k < HALF else later).frame(k)
        yield DepthFrame(frame.stamp_ns, frame.depth, frame.camera), inverse(frame.T_sensor_target)


def key_frames(second, count=None):
    """Views and true poses of the first so many of them; None: of all."""
    preprocessor = Preprocessor(Settings().isolation, Settings().normals)
    seen = [(View(preprocessor.process(frame)), T) for frame, T in islice(frames(second), count)]
    return [view for view, _ in seen], [T for _, T in seen]
