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

"""Compare a scan with the truth: ``python examples/evaluate_scan.py``."""

from typing import Any

import debris_scanner as ds
from debris_scanner.sim.session import Simulation, SimulationSettings

simulation = Simulation(SimulationSettings(range_m=1.6, spin_rad_s=1.0, rate_hz=6, seconds=7.5))


def main() -> dict[str, Any]:
    """Scan a simulated target, whose poses and mesh are known."""
    scanner, poses, frames = ds.Scanner(), {}, []
    for f in simulation:
        scanner.add(f.depth_mm, f.camera, f.stamp_ns)
        poses[f.stamp_ns] = f.T_sensor_target
        frames.append(ds.DepthFrame(f.stamp_ns, f.depth, f.camera))
    mesh = simulation.target.vertices, simulation.target.triangles
    figures = ds.evaluate(scanner.finish(), ds.Truth(poses, mesh), frames)
    for name in ('attitude_deg', 'position_mm', 'model_mm', 'completeness', 'verdict'):
        print(f'{name:14s}{figures[name]}')
    return figures


if __name__ == '__main__':
    main()
