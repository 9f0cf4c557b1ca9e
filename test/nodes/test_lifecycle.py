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

"""Lifecycle of real nodes: driven by services, or by themselves."""

import json
import time

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from test_preprocess import disc_cloud

pytestmark = pytest.mark.ros

MANUAL = ['--ros-args', '-p', 'autostart:=false']
T = Transition


def state(peer, node):
    return peer.call(GetState, f'{node}/get_state').current_state.label


def change(peer, node, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return peer.call(ChangeState, f'{node}/change_state', request).success


def put(peer, node, name, text):
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    return peer.call(SetParameters, f'{node}/set_parameters', request).results[0]


def wait(peer, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        peer.executor.spin_once(0.05)


def test_a_managed_node_takes_frames_only_while_it_is_active(nodes, peer):
    nodes.start('preprocess', MANUAL)
    targets = peer.listen(PointCloud2, 'target_points')
    assert state(peer, 'preprocess') == 'unconfigured'
    assert not change(peer, 'preprocess', T.TRANSITION_ACTIVATE)
    peer.until(lambda: peer.reports.get('preprocess'), 'a report')
    assert peer.reports['preprocess'].message == 'unconfigured'
    assert not peer.node.get_subscriptions_info_by_topic('points')

    for first_ns in (1_000_000_000, 500_000_000):  # once more after a cleanup, with a scan of its own
        assert change(peer, 'preprocess', T.TRANSITION_CONFIGURE)
        assert state(peer, 'preprocess') == 'inactive'
        points = peer.talk(PointCloud2, 'points')
        points.publish(disc_cloud(first_ns))
        wait(peer, 1.0)
        assert not targets
        assert change(peer, 'preprocess', T.TRANSITION_ACTIVATE)
        points.publish(disc_cloud(first_ns + 1))
        peer.until(lambda: len(targets) == 1, 'a target')
        assert change(peer, 'preprocess', T.TRANSITION_DEACTIVATE)
        points.publish(disc_cloud(first_ns + 2))
        wait(peer, 1.0)
        assert len(targets) == 1
        assert change(peer, 'preprocess', T.TRANSITION_ACTIVATE)
        points.publish(disc_cloud(first_ns + 3))
        peer.until(lambda: len(targets) == 2, 'the next target')
        assert change(peer, 'preprocess', T.TRANSITION_DEACTIVATE)
        assert change(peer, 'preprocess', T.TRANSITION_CLEANUP)
        assert state(peer, 'preprocess') == 'unconfigured'
        peer.until(lambda: not peer.node.get_subscriptions_info_by_topic('points'), 'the end of it')
        peer.node.destroy_publisher(points)
        targets.clear()
    assert change(peer, 'preprocess', T.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert nodes.wait('preprocess', 30)
    assert nodes.exit_code('preprocess') == 0


@pytest.mark.parametrize('node', ['preprocess', 'odometry', 'closure', 'graph', 'scanner'])
def test_run_alone_a_node_starts_itself_and_can_be_taken_through_all_states(nodes, peer, node):
    nodes.start(node)
    peer.until(lambda: state(peer, node) == 'active', f'{node} active')
    for transition, reached in (
        (T.TRANSITION_DEACTIVATE, 'inactive'),
        (T.TRANSITION_CLEANUP, 'unconfigured'),
        (T.TRANSITION_CONFIGURE, 'inactive'),
        (T.TRANSITION_ACTIVATE, 'active'),
    ):
        assert change(peer, node, transition)
        assert state(peer, node) == reached
        peer.until(
            lambda r=reached: node in peer.reports and peer.reports[node].values['lifecycle'] == r,
            f'a report: {reached}',
        )
    assert peer.call(Trigger, f'{node}/reset').success
    nodes.interrupt(node)
    assert nodes.wait(node, 30)
    assert nodes.exit_code(node) == 0


def test_parameters_can_be_listed_and_set_until_a_manager_configures_the_node(nodes, peer, tmp_path):
    nodes.start('graph', MANUAL)
    names = peer.call(ListParameters, 'graph/list_parameters').result.names
    assert {'model', 'output_dir', 'journal_dir', 'save_as', 'fusion.voxel', 'finish_after_idle'} <= set(
        names
    )
    first, second = tmp_path / 'first', tmp_path / 'second'
    assert put(peer, 'graph', 'output_dir', str(first)).successful
    assert put(peer, 'graph', 'model', '/none.ply').successful
    assert not change(peer, 'graph', T.TRANSITION_CONFIGURE)
    said = 'cannot be configured: mesh file not found: /none.ply'
    assert said in (tmp_path / 'logs' / 'graph.log').read_text()
    assert put(peer, 'graph', 'model', '').successful
    assert change(peer, 'graph', T.TRANSITION_CONFIGURE)
    refused = put(peer, 'graph', 'output_dir', str(second))
    assert not refused.successful
    said = 'output_dir is fixed while the node is inactive: clean up, set it, configure again'
    assert refused.reason == said
    assert change(peer, 'graph', T.TRANSITION_CLEANUP)
    assert put(peer, 'graph', 'output_dir', str(second)).successful
    assert change(peer, 'graph', T.TRANSITION_CONFIGURE)
    assert not put(peer, 'graph', 'model', 'x').successful
    assert change(peer, 'graph', T.TRANSITION_CLEANUP)
    assert [(folder / 'summary.json').is_file() for folder in (first, second)] == [True, True]


@pytest.mark.parametrize('node', ['graph', 'scanner'])
def test_a_model_that_cannot_be_used_ends_a_node_with_one_line(nodes, peer, tmp_path, node):
    broken = tmp_path / 'broken.ply'
    broken.write_text('no mesh')
    nodes.start(node, ['--ros-args', '-p', f'model:={broken}'])
    assert nodes.wait(node, 60)
    assert nodes.exit_code(node) == 2
    log = (tmp_path / 'logs' / f'{node}.log').read_text()
    assert 'Traceback' not in log
    assert log.count('broken.ply') == 1, log


def test_a_cleanup_saves_and_a_configuration_that_cannot_be_says_why(nodes, peer, tmp_path):
    out, earlier = tmp_path / 'out', '{"model": {"points": 9}}'
    nodes.start('graph', [*MANUAL, '-p', f'output_dir:={out}'])
    out.write_text('a file is in the way')
    assert not change(peer, 'graph', T.TRANSITION_CONFIGURE)
    assert state(peer, 'graph') == 'unconfigured'
    log = next((tmp_path / 'logs').glob('graph.log')).read_text()
    assert 'cannot be configured: cannot write to output folder' in log
    out.unlink()
    assert change(peer, 'graph', T.TRANSITION_CONFIGURE)
    assert change(peer, 'graph', T.TRANSITION_ACTIVATE)
    assert change(peer, 'graph', T.TRANSITION_DEACTIVATE)
    assert change(peer, 'graph', T.TRANSITION_CLEANUP)
    assert json.loads((out / 'summary.json').read_text())['reason'] == 'interrupted'
    (out / 'summary.json').write_text(earlier)  # another scan has made a model there meanwhile
    assert change(peer, 'graph', T.TRANSITION_CONFIGURE)
    nodes._children['graph'].process.terminate()
    assert nodes.wait('graph', 30)
    assert nodes.exit_code('graph') == 0
    assert (out / 'summary.json').read_text() == earlier
    assert json.loads((out / 'no_model' / 'summary.json').read_text())['result'] == 'no_model'
