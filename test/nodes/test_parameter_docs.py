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

"""docs/parameters.md says what the nodes declare, and a key that none of them knows is refused by name."""

import subprocess
import sys

import pytest
from live_runs import ROOT
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters

from debris_scanner.nodes.lifecycle.diagnostics import TOPIC
from debris_scanner.nodes.lifecycle.parameters import NODES

pytestmark = pytest.mark.ros


def test_the_document_is_the_generated_one(domain, session_bag):
    made = subprocess.run(
        [sys.executable, '-m', 'debris_scanner.nodes.parameter_docs', str(session_bag)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert made.returncode == 0, made.stderr
    assert made.stdout == (ROOT / 'docs' / 'parameters.md').read_text(), (
        'a declared parameter changed: '
        'python -m debris_scanner.nodes.parameter_docs bags/shuttle_stack_spin > docs/parameters.md'
    )
    found = {node: [] for node in NODES}
    for part in made.stdout.split('## Parameters of the nodes')[1].split('\n### ')[1:]:
        rows = [line for line in part.splitlines() if line.startswith('| `')]
        for row in rows:
            assert row.split('|')[3].strip(), f'no meaning: {row}'
        for node in part.split('\n')[0].split(', '):
            found[node] += [row.split('`')[1] for row in rows]
    for node, names in NODES.items():
        assert tuple(sorted(found[node])) == names, 'NODES of nodes/lifecycle/parameters.py'


@pytest.mark.parametrize(
    ('section', 'said'),
    [
        ('/**', "unknown parameter odometry.keyframe_angel_deg; did you mean 'odometry.keyframe_angle_deg'?"),
        ('odometry', 'unknown parameter odometry.keyframe_angel_deg'),
    ],
)
def test_an_unknown_key_of_a_file_is_refused_by_name(nodes, tmp_path, section, said):
    path = tmp_path / 'params.yaml'
    text = 'odometry:\n      keyframe_angel_deg: 4.0\n    output_dir: there'
    path.write_text(f'{section}:\n  ros__parameters:\n    {text}\n')
    nodes.start('odometry', ['--ros-args', '--params-file', str(path)])
    assert nodes.wait('odometry', 60)
    assert nodes.exit_code('odometry') == 2
    assert said in nodes.last_words('odometry')


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('/**:\n  ros__parameters:\n    a: [1, "x"]\n', 'Sequence should be of same type'),
        (None, 'Error opening YAML file'),
    ],
)
def test_a_file_that_cannot_be_read_is_named_in_one_line(nodes, tmp_path, text, said):
    path = tmp_path / 'params.yaml'
    if text is not None:
        path.write_text(text)
    nodes.start('odometry', ['--ros-args', '--params-file', str(path)])
    assert nodes.wait('odometry', 60)
    assert nodes.exit_code('odometry') == 2
    assert str(path) in nodes.last_words('odometry') and said in nodes.last_words('odometry')
    assert 'Traceback' not in (tmp_path / 'logs' / 'odometry.log').read_text()


def test_a_file_for_all_nodes_may_name_what_others_have(nodes, peer, tmp_path):
    path = tmp_path / 'params.yaml'
    path.write_text(f'/**:\n  ros__parameters:\n    output_dir: {tmp_path / "out"}\n    bag: there\n')
    nodes.start('odometry', ['--ros-args', '--params-file', str(path), '-p', 'use_sim_time:=false'])
    peer.until(lambda: 'odometry' in peer.reports, f'odometry on {TOPIC}')
    nodes.check()


def test_live_and_read_only_over_services(nodes, peer):
    nodes.start('scanner')
    peer.until(lambda: 'scanner' in peer.reports, 'the scanner')
    names = ['odometry.max_loss', 'motion.rate_sigma', 'finish_after_idle']
    request = DescribeParameters.Request(names=names)
    described = peer.call(DescribeParameters, 'scanner/describe_parameters', request).descriptors
    assert [d.read_only for d in described] == [False, True, False]
    assert described[0].description.endswith('[nat]')

    def set_to(name, value):
        wrapped = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=wrapped)])
        (result,) = peer.call(SetParameters, 'scanner/set_parameters', request).results
        return result.successful, result.reason

    assert set_to('odometry.max_loss', 2.0)[0]
    assert not set_to('odometry.max_loss', 0.003)[0]
    assert not set_to('motion.rate_sigma', 0.5)[0]
    assert set_to('finish_after_idle', 20.0)[0]
    nodes.check()
