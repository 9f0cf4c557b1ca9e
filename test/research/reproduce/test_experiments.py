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

"""What is simulated, and with which settings."""

import numpy as np
import pytest

from debris_scanner.core.geometry import log_so3
from debris_scanner.research.reproduce.experiments import (
    EXPERIMENTS,
    searching_greedily,
    stage,
    thesis_settings,
)
from debris_scanner.research.reproduce.scores import after_one_turn
from debris_scanner.sim.session import Simulation


def poses(simulation):
    return {simulation.stamp_ns(k): simulation.pose(k) for k in range(len(simulation))}


@pytest.mark.parametrize('key', EXPERIMENTS)
@pytest.mark.parametrize('quick', [False, True])
def test_every_experiment_shows_more_than_one_turn(key, quick):
    simulation = stage(EXPERIMENTS[key], quick)
    stamp = after_one_turn(poses(simulation))
    assert stamp is not None
    assert stamp < simulation.stamp_ns(len(simulation) - 1)


def test_rates_are_those_of_the_thesis():
    assert {k: e.simulation.rate_hz for k, e in EXPERIMENTS.items()} == {'1': 5, '2': 10, '3': 5, 'cw': 5}
    for key, experiment in EXPERIMENTS.items():
        assert thesis_settings(experiment).odometry.sample_rate == experiment.simulation.rate_hz, key


def test_wobble_nods_the_target_about_its_centre():
    experiment = EXPERIMENTS['1']
    steady, wobbling = Simulation(experiment.simulation), stage(experiment)
    tilts = []
    for k in range(len(steady)):
        a, b = steady.pose(k), wobbling.pose(k)
        np.testing.assert_allclose(a[:3, 3], b[:3, 3], atol=1e-12)
        tilts.append(np.degrees(np.linalg.norm(log_so3(b[:3, :3] @ a[:3, :3].T))))
    assert max(tilts) == pytest.approx(2.0, abs=1e-6)


def test_the_second_target_comes_to_rest():
    found = list(poses(stage(EXPERIMENTS['2'])).values())
    assert np.linalg.norm(log_so3(found[0][:3, :3].T @ found[1][:3, :3])) > np.radians(9)
    assert np.linalg.norm(log_so3(found[-2][:3, :3].T @ found[-1][:3, :3])) < 1e-9


def test_presets_are_the_tables_but_for_the_named_departures():
    one, two, three = (thesis_settings(EXPERIMENTS[k]) for k in ('1', '2', '3'))
    assert (one.closure.min_probability, two.closure.min_probability) == (0.82, 0.8)
    assert (one.closure.search, two.closure.search) == ('frugal', 'greedy')
    assert two.ekf.prior_state[5] == 3.0
    assert three.relaxation.max_distance == 0.03
    assert one.relaxation.voxel == three.relaxation.voxel == 0.0
    assert two.relaxation.voxel == searching_greedily(three).relaxation.voxel == 0.004
    assert searching_greedily(three).closure.search == 'greedy'
    prior, rate = one.ekf.prior_state[5], EXPERIMENTS['1'].simulation.spin_rad_s
    assert abs((prior - rate) / rate) == pytest.approx(1.43, abs=0.005)  # section 4.2
