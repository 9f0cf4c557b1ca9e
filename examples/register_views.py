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

"""Register two depth images of one target: ``python examples/register_views.py``."""

from itertools import islice

import numpy as np

import debris_scanner as ds
from debris_scanner.core.geometry import rotation_angle
from debris_scanner.sim.session import Simulation, SimulationSettings

# In place of your camera: two views of a target that turns by 5 degrees from one to the next.
simulation = Simulation(SimulationSettings(spin_rad_s=np.radians(50), rate_hz=10))


def main() -> ds.Registration:
    """How far the target has turned between the views, and whether they agree."""
    first, second = islice(simulation, 2)
    a, b = (ds.DepthFrame(f.stamp_ns, f.depth_mm, f.camera) for f in (first, second))
    found = ds.register(a, b)
    if found:
        print(f'turned by {np.degrees(rotation_angle(found.T_a_b[:3, :3])):.2f} deg: {found.why}')
    else:
        print(f'they do not agree: {found.why}')
    return found


if __name__ == '__main__':
    main()
