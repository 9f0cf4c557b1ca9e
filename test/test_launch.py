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

"""The launch files as far as they can be read; `nodes/test_launch_files.py` runs them."""

import ast
from pathlib import Path

import pytest
import yaml

from debris_scanner.nodes.lifecycle.parameters import NODES
from debris_scanner.nodes.publishing.frame_names import FrameNames

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / 'launch').glob('*.launch.py'))


def declared(path):
    """Names of the launch arguments."""
    tree = ast.parse(path.read_text())
    (table,) = (
        node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == 'ARGUMENTS'
    )
    return {key.value for key in table.keys}


def test_there_are_two():
    assert [path.name for path in FILES] == ['demo.launch.py', 'scan.launch.py']


@pytest.mark.parametrize('path', FILES, ids=lambda p: p.name)
def test_compiles_and_uses_no_argument_that_it_does_not_declare(path):
    code = path.read_text()
    compile(code, path.name, 'exec')
    used = {
        node.args[0].value
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ('LaunchConfiguration', 'value', 'flag', 'path', 'text')
        and isinstance(node.args[0], ast.Constant)
    }
    assert used == declared(path)
    assert 'generate_launch_description' in {n.name for n in ast.parse(code).body if hasattr(n, 'name')}


def test_scan_takes_what_the_contract_names():
    assert declared(ROOT / 'launch' / 'scan.launch.py') >= {'bag', 'params', 'rviz'}


def test_demo_hands_on_only_what_scan_takes():
    tree = ast.parse((ROOT / 'launch' / 'demo.launch.py').read_text())
    handed = {
        key.value
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword) and node.arg == 'launch_arguments'
        for key in node.value.func.value.keys
    }
    assert handed
    assert handed <= declared(ROOT / 'launch' / 'scan.launch.py')


def test_parameters_given_to_nodes_are_declared_there():
    """Every key of a parameter dictionary is declared by some node."""
    sources = ''.join(p.read_text() for p in (ROOT / 'debris_scanner' / 'nodes').rglob('*.py'))
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Dict) and node.keys and path.name and _is_parameters(node):
                for key in node.keys:
                    assert f"'{key.value}'" in sources, f'{path.name}: {key.value}'


def _is_parameters(node):
    names = {k.value for k in node.keys if isinstance(k, ast.Constant)}
    return (
        bool(names & {'input_reliability', 'output_dir', 'wait_for_stages'})
        and 'params' not in names
        and ('rviz' not in names)
    )


def test_the_aggregator_finds_the_status_of_every_node_once():
    config = yaml.safe_load((ROOT / 'rviz' / 'diagnostic_aggregator.yaml').read_text())
    groups = [g for g in config['analyzers']['ros__parameters'].values() if isinstance(g, dict)]
    assert {g['type'] for g in groups} == {'diagnostic_aggregator/GenericAnalyzer'}
    for node in NODES:
        name = f'left/{node}: {node}'  # as nodes/lifecycle/diagnostics.py makes it
        assert [any(text in name for text in g['contains']) for g in groups].count(True) == 1, node


def test_rviz_shows_our_topics():
    view = yaml.safe_load((ROOT / 'rviz' / 'scan.rviz').read_text())
    fixed = view['Visualization Manager']['Global Options']['Fixed Frame']
    assert fixed == FrameNames().sensor  # of whichever driver
    topics = {d['Topic']['Value'] for d in view['Visualization Manager']['Displays'] if 'Topic' in d}
    assert topics == {'/target_points', '/odometry', '/model', '/model_mesh', '/graph_markers'}
