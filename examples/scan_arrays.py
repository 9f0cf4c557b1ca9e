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

"""Scan depth images that are numpy arrays: ``python examples/scan_arrays.py [OUT]``."""

import sys
from pathlib import Path

import debris_scanner as ds
from debris_scanner.sim.session import Simulation, SimulationSettings

# In place of your camera: a target that turns once in 6.3 s, seen six times a second.
frames = Simulation(SimulationSettings(range_m=1.6, spin_rad_s=1.0, rate_hz=6, seconds=7.5))


def main(out: Path) -> ds.ScanResult:
    """Scan, show what happens, and save the result."""
    scanner = ds.Scanner()
    for frame in frames:  # depth_mm: (480, 640) uint16, millimetres, 0 where nothing was measured
        estimate = scanner.add(frame.depth_mm, frame.camera, frame.stamp_ns)
        for event in scanner.poll():
            print(f'{estimate.stamp_ns / 1e9:6.2f} s  {estimate.state}: {type(event).__name__}')
    result = scanner.finish()
    if result:
        print(f'a model of {len(result.model.points)} points: {result.why}')
    else:
        print(f'no model: {result.reason}: {result.why}')
    print(f'saved in {result.save(out)}')
    return result


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else 'out/example'))
