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

"""Settings as ROS parameters: descriptors, ranges, what may change and when it takes hold."""

from types import SimpleNamespace

import pytest
import rclpy
from rcl_interfaces.msg import ParameterType
from rclpy.context import Context
from rclpy.parameter import Parameter

from debris_scanner.core.parameters import ParameterError, flatten
from debris_scanner.nodes.lifecycle.parameters import (
    SettingsParameters,
    declare,
    declare_live,
    declare_path,
    refuse_unknown,
)
from debris_scanner.settings import Settings


@pytest.fixture
def make_node():
    context = Context()
    nodes = []

    def make(**overrides):
        given = [Parameter(name.replace('__', '.'), value=value) for name, value in overrides.items()]
        nodes.append(
            rclpy.create_node(
                f'node{len(nodes)}', context=context, parameter_overrides=given, enable_rosout=False
            )
        )
        return nodes[-1]

    rclpy.init(args=[], context=context, domain_id=101)
    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_every_setting_is_declared_with_its_description_range_and_default(make_node):
    node = make_node()
    groups = {name.split('.')[0] for name in flatten(Settings())}
    parameters = SettingsParameters(node, groups, live=('odometry',))
    assert parameters.value == Settings()
    for name, value in flatten(Settings()).items():
        assert node.get_parameter(name).value == value or list(node.get_parameter(name).value) == value
        descriptor = node.describe_parameter(name)
        assert descriptor.description, name
        assert descriptor.read_only == (not name.startswith('odometry.')), name
    descriptor = node.describe_parameter('odometry.keyframe_angle_deg')
    assert descriptor.type == ParameterType.PARAMETER_DOUBLE
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (
        0.5,
        45.0,
    )
    assert '[deg]' in descriptor.description
    assert node.describe_parameter('isolation.min_pixels').integer_range[0].from_value == 20


def test_values_of_the_start_are_taken(make_node):
    node = make_node(odometry__lost_after=7, isolation__box_max=[0.1, 0.2, 0.9])
    value = SettingsParameters(node, ('odometry', 'isolation')).value
    assert value.odometry.lost_after == 7
    assert value.isolation.box_max == (0.1, 0.2, 0.9)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('odometry__lost_after', 0),
        ('odometry__lost_after', 'many'),
        ('odometry__max_loss', 0.0029),  # below its range
        ('isolation__box_max', [0.1, 0.2]),
    ],
)
def test_a_bad_value_of_the_start_is_named(make_node, name, value):
    with pytest.raises(ParameterError, match=name.replace('__', '.')):
        SettingsParameters(make_node(**{name: value}), ('odometry', 'isolation'))


def test_a_change_takes_hold_whole_or_not_at_all(make_node):
    node = make_node()
    applied = []
    parameters = SettingsParameters(node, ('odometry', 'motion'), live=('odometry',), apply=applied.append)

    good = Parameter('odometry.lost_after', value=9)
    (result,) = node.set_parameters([good])
    assert result.successful
    assert [s.odometry.lost_after for s in applied] == [9]
    assert parameters.value.odometry.lost_after == 9

    bad = Parameter('odometry.max_loss', value=0.0029)
    result = node.set_parameters_atomically([Parameter('odometry.lost_after', value=4), bad])
    assert not result.successful
    assert 'max_loss' in result.reason
    assert parameters.value.odometry.lost_after == 9
    assert len(applied) == 1

    (result,) = node.set_parameters([Parameter('motion.rate_sigma', value=0.5)])
    assert not result.successful
    assert parameters.value.motion == Settings().motion


def test_choices_and_ranges_of_a_nodes_own(make_node):
    node = make_node(mood='sad', size=11)
    with pytest.raises(ParameterError, match='mood must be one of happy, calm'):
        declare(node, 'mood', 'happy', 'how it is', choices=('happy', 'calm'))
    with pytest.raises(ParameterError, match='size'):
        declare(node, 'size', 5, 'how large', 1, 10)
    assert declare(node, 'colour', 'red', 'which', choices=('red', 'blue')) == 'red'


def test_a_box_inside_out_is_refused_at_the_start_and_later(make_node):
    with pytest.raises(ParameterError, match=r'box_min must lie below isolation\.box_max: z 2 and 1 m'):
        given = {'isolation__box_min': [-1.0, -1.0, 2.0], 'isolation__box_max': [1.0, 1.0, 1.0]}
        SettingsParameters(make_node(**given), ('isolation',))
    node = make_node()
    SettingsParameters(node, ('isolation',), live=('isolation',))
    (result,) = node.set_parameters([Parameter('isolation.box_min', value=[0.0, 0.0, 30.0])])
    assert not result.successful
    assert 'box_min must lie below' in result.reason


def test_a_tilde_is_the_home_folder(make_node, monkeypatch, tmp_path):
    monkeypatch.setenv('HOME', str(tmp_path))
    node = make_node(folder='~/x', other='')
    assert declare_path(node, 'folder', 'where') == tmp_path / 'x'
    assert declare_path(node, 'other', 'where') is None


def test_a_parameter_of_another_node_is_named_with_its_owners(make_node):
    said = []
    node = make_node(output_dir='/x', odometry__lost_after=7)  # the second stands in every parameter file
    node.get_logger = lambda: SimpleNamespace(warning=said.append)
    refuse_unknown(node)
    assert said == ['parameter output_dir is ignored here: it is one of graph, scanner']
    with pytest.raises(ParameterError, match='unknown parameter output_dri'):
        refuse_unknown(make_node(output_dri='/x'))


def test_a_parameter_of_another_package_is_warned_of_and_a_mistake_in_our_groups_is_not_taken(make_node):
    said = []
    node = make_node(frame_rate=30, publish_rate=5.0, use_intra_process=True)
    node.get_logger = lambda: SimpleNamespace(warning=said.append)
    refuse_unknown(node)
    assert said == [
        'frame_rate, publish_rate, use_intra_process are no parameter of this package, and ignored'
    ]
    with pytest.raises(ParameterError, match=r'unknown parameter isolation\.anything'):
        refuse_unknown(make_node(isolation__anything=3, frame_rate=30))


def test_a_value_that_its_check_refuses_is_not_set(make_node):
    def even(value):
        if value % 2:
            raise ParameterError(f'{value} is odd')

    with pytest.raises(ParameterError, match='3 is odd'):
        declare_live(make_node(size=3), 'size', 2, 'how large', check=even)
    node = make_node()
    size = declare_live(node, 'size', 2, 'how large', check=even)
    assert not node.set_parameters([Parameter('size', value=5)])[0].successful
    assert node.set_parameters([Parameter('size', value=6)])[0].successful
    assert size() == 6
