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

"""Nobody on the domain chooses where a node writes, or what it loads."""

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters, SetParametersAtomically
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros

PATHS = ('bag', 'device', 'journal_dir', 'library', 'model', 'output_dir', 'truth_dir')


def wish(name, value):
    return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value))


def refused(peer, node, name, value):
    """Whether a node lets nobody set a path, one by one or all at once."""
    request = SetParameters.Request(parameters=[wish(name, value)])
    (result,) = peer.call(SetParameters, f'{node}/set_parameters', request).results
    together = SetParametersAtomically.Request(parameters=[wish(name, value)])
    whole = peer.call(SetParametersAtomically, f'{node}/set_parameters_atomically', together).result
    return not result.successful and not whole.successful


def change(peer, node, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return peer.call(ChangeState, f'{node}/change_state', request).success


def test_save_as_names_a_folder_inside_when_it_is_set(nodes, peer, tmp_path):
    nodes.start('graph', ['--ros-args', '-p', f'output_dir:={tmp_path / "own"}'])
    for name in ('../../etc', '/etc', '..', 'a/b', '.saved'):
        assert refused(peer, 'graph', 'save_as', name), name
    request = SetParameters.Request(parameters=[wish('save_as', '../../etc')])
    reason = peer.call(SetParameters, 'graph/set_parameters', request).results[0].reason
    assert reason == "save_as names a folder inside output_dir, got '../../etc'"
    request = SetParameters.Request(parameters=[wish('save_as', 'first')])
    assert peer.call(SetParameters, 'graph/set_parameters', request).results[0].successful
    peer.call(Trigger, 'graph/save_model')
    assert (tmp_path / 'own' / 'first' / 'summary.json').is_file()


@pytest.mark.parametrize('node', ['preprocess', 'graph', 'scanner', 'sim_kinect'])
def test_paths_are_read_only_and_results_stay_in_their_folder(nodes, peer, tmp_path, node):
    own, elsewhere = tmp_path / 'own', tmp_path / 'elsewhere'
    given = {
        'graph': 'output_dir',
        'scanner': 'output_dir',
        'preprocess': 'journal_dir',
        'sim_kinect': 'truth_dir',
    }
    stays = ['-p', 'stay:=true', '-p', 'seconds:=0.2'] if node == 'sim_kinect' else []
    nodes.start(node, ['--ros-args', '-p', f'{given[node]}:={own}', *stays])
    names = peer.call(ListParameters, f'{node}/list_parameters').result.names
    paths = [name for name in names if name in PATHS]
    assert given[node] in paths
    described = peer.call(
        DescribeParameters, f'{node}/describe_parameters', DescribeParameters.Request(names=paths)
    )
    assert all(d.read_only for d in described.descriptors)
    assert all(refused(peer, node, name, str(elsewhere)) for name in paths)
    if node in ('graph', 'scanner'):
        answer = peer.call(Trigger, f'{node}/save_model')
        assert not answer.success  # there is no model; what there is is saved
        assert answer.message.startswith('no model: no_target, saved: ')
        assert (own / 'summary.json').is_file()
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            assert change(peer, node, transition)
        assert all(refused(peer, node, name, str(elsewhere)) for name in paths)
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert change(peer, node, transition)
        assert peer.call(Trigger, f'{node}/finish').success
    nodes.check()
    assert not elsewhere.exists()
    assert {p.name for p in tmp_path.iterdir()} <= {'own', 'logs'}
