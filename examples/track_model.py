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

"""Track a model that you have: ``python examples/track_model.py [MESH or OUT of a scan]``."""

import sys
from typing import Any

import numpy as np
import trimesh

import debris_scanner as ds
from debris_scanner.sim.session import Simulation, SimulationSettings

# In place of your camera: the shuttle stack, which turns at 20 degrees a second.
frames = Simulation(SimulationSettings(spin_rad_s=0.35, rate_hz=6, seconds=3))
mesh = trimesh.Trimesh(frames.target.vertices, frames.target.triangles)


def main(model: Any) -> list[ds.Estimate]:
    """Find the model in the frames, and follow it."""
    tracker = ds.Tracker(model)  # a Model, a ScanResult, a path, or a mesh of trimesh or Open3D
    estimates = [tracker.add(f.depth_mm, f.camera, f.stamp_ns) for f in frames]
    for estimate in estimates:
        if estimate.in_model_frame and estimate.accepted:
            x, y, z = estimate.T_sensor_target[:3, 3]
            rate = np.degrees(np.linalg.norm(estimate.omega))
            seconds = estimate.stamp_ns / 1e9
            print(f'{seconds:6.2f} s  at ({x:+.3f}, {y:+.3f}, {z:.3f}) m, turns at {rate:.1f} deg/s')
    return estimates


if __name__ == '__main__':
    main(sys.argv[1] if len(sys.argv) > 1 else mesh)
