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
import signal
import time

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
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
    nodes._children['graph'].process.send_signal(signal.SIGTERM)
    assert nodes.wait('graph', 30)
    assert nodes.exit_code('graph') == 0
    assert (out / 'summary.json').read_text() == earlier
    assert json.loads((out / 'no_model' / 'summary.json').read_text())['result'] == 'no_model'
