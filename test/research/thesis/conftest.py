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

"""One simulated turn of the shuttle, and settings coarse enough for tests."""

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.parameters import updated
from debris_scanner.research.thesis.odometry import estimate
from debris_scanner.research.thesis.settings import ThesisSettings
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sim.session import Simulation, SimulationSettings


@pytest.fixture(scope='session')
def turning():
    """Target frames at 5 Hz of a spin about -y at 0.65 rad/s, 12 s, and T_sensor_target by stamp."""
    simulation = Simulation(
        SimulationSettings(
            'shuttle_stack', rate_hz=5.0, seconds=12.0, spin_rad_s=-0.65, axis_sensor=(0.0, 1.0, 0.0), seed=1
        )
    )
    preprocess = Preprocessor(IsolationSettings(), NormalSettings())
    frames = [
        preprocess.process(DepthFrame(f.stamp_ns, f.depth_mm.astype(np.float32) / 1000, f.camera))
        for f in simulation
    ]
    truth = {f.stamp_ns: simulation.pose(k) for k, f in enumerate(frames)}
    return frames, truth


@pytest.fixture(scope='session')
def coarse():
    return updated(
        ThesisSettings(),
        {
            'odometry.voxel': 0.004,
            'odometry.iterations': 25,
            'odometry.keyframe_angle_deg': 0.0,
            'relaxation.voxel': 0.006,
            'relaxation.outer_iterations': 15,
            'refiner.voxel': 0.004,
            'refiner.order': 2,
            'refiner.ball_radii': [0.004, 0.008],
        },
    )


@pytest.fixture(scope='session')
def turning_odometry(turning, coarse):
    return estimate(turning[0], coarse)
