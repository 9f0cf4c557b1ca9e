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

"""The simulated sensor's node takes every setting of a simulation, as ``live --simulate`` sends them."""

import dataclasses

import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from debris_scanner.core.parameters import ParameterError
from debris_scanner.nodes.lifecycle.parameters import NODES
from debris_scanner.nodes.sim_kinect import declared_settings
from debris_scanner.sim.session import SimulationSettings

# each differs from its default
OTHERS = SimulationSettings(
    target='bunny',
    motion='tumble',
    seed=3,
    rate_hz=15.0,
    seconds=7.0,
    size=0.4,
    spin_rad_s=0.3,
    axis_sensor=(0.0, 1.0, 0.5),
    range_m=1.1,
    gaps=True,
    gaps_from_s=2.0,
    patchy=True,
    leaves_s=5.0,
    mli=True,
    mli_share=0.5,
    noise=False,
    correlated=True,
    clutter='wall',
    colour=True,
    infrared=True,
    paint='markings',
    light='lamp',
    sensor='d435',
    spin_about='y',
    inertia=(1.0, 0.9, 0.3),
    centre_of_mass=(0.01, 0.0, -0.02),
    damping_s=40.0,
    spatial_filter=True,
    temporal_filter=True,
    bump_px=0.1,
    junk_share=0.001,
    doubled=True,
    hand=True,
    focal_error=0.02,
)


@pytest.fixture
def make_node():
    context = Context()
    nodes = []

    def make(**given):
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        nodes.append(
            rclpy.create_node('sim', context=context, parameter_overrides=overrides, enable_rosout=False)
        )
        return nodes[-1]

    rclpy.init(args=[], context=context, domain_id=101)
    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_nothing_given_is_the_default_simulation(make_node):
    assert declared_settings(make_node()) == SimulationSettings()


def test_every_setting_is_a_parameter(make_node):
    given = dataclasses.asdict(OTHERS)
    default = dataclasses.asdict(SimulationSettings())
    assert [name for name in given if given[name] == default[name]] == []
    assert given.keys() <= set(NODES['sim_kinect'])
    lists = {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}
    assert declared_settings(make_node(**lists)) == OTHERS


@pytest.mark.parametrize('name', ['axis_sensor', 'inertia', 'centre_of_mass'])
def test_three_numbers_are_needed(make_node, name):
    with pytest.raises(ParameterError, match=f'{name} needs 3 values'):
        declared_settings(make_node(**{name: [1.0, 2.0]}))
