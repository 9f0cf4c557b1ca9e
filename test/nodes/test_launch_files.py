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

"""The launch files run with real nodes, by ``launch`` or by a stand-in for it, as PyPI has none."""

import json

import pytest
from launching import ROOT, EmitEvent, Launched, install
from live_runs import assert_kept_up
from real_ros import ENVIRONMENT

pytestmark = [pytest.mark.ros, pytest.mark.slow]
SCAN, DEMO = (ROOT / 'launch' / f'{name}.launch.py' for name in ('scan', 'demo'))
STAGES = ['preprocess', 'odometry', 'closure', 'graph']
LONGEST_S = 180.0


@pytest.fixture
def launch(domain, monkeypatch, tmp_path):
    """Run a launch file with arguments, in a folder of its own."""
    install(monkeypatch)
    return lambda path, **arguments: Launched(path, arguments, tmp_path / 'launch')


def model_of(out):
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['reason'] is None, summary
    assert (out / 'model.ply').stat().st_size > 10_000
    return summary


# composed, the interpreter is not free while a model is made: a busy machine loses what comes then
@pytest.mark.parametrize('composed', ['false', pytest.param('true', marks=pytest.mark.timing)])
def test_scan_of_a_bag_saves_a_model_and_ends(launch, two_turns_bag, tmp_path, composed):
    if composed == 'true' and ENVIRONMENT.is_file():
        pytest.skip('done by the real launch')
    out = tmp_path / 'scan'
    given = {'bag': str(two_turns_bag), 'out': str(out), 'exit_when_done': 'true', 'composed': composed}
    given['rate'] = '1.25'
    with launch(SCAN, **given) as running:
        owner = 'scanner' if composed == 'true' else 'graph'
        assert list(running.processes) == [*(['scanner'] if composed == 'true' else STAGES), 'play_bag']
        code, follows = running.wait(owner, LONGEST_S)
        assert code == 0, running.log(owner).read_text()
        assert [type(action) for action in follows] == [EmitEvent]
        ended = follows[0].event.process_matcher
        assert all(ended(node) for node in running.nodes.values())
        assert running.wait('play_bag', LONGEST_S) == (0, [])
        # other stages may still write to it
        assert (out / 'journal').is_dir() == (composed == 'false')
    assert not (out / 'journal').exists()
    assert all(process.returncode == 0 for process in running.processes.values())
    assert_kept_up(model_of(out), float(given['rate']))


def test_demo_simulates_scans_and_saves_when_interrupted(launch, tmp_path):
    out = tmp_path / 'demo'
    with launch(DEMO, seconds='15.0', out=str(out)) as running:
        assert sorted(running.processes) == sorted([*STAGES, 'sim_kinect'])
        assert running.wait('sim_kinect', LONGEST_S) == (0, []), running.log('sim_kinect').read_text()
    assert all(process.returncode == 0 for process in running.processes.values())
    model_of(out)
    assert (out / 'truth' / 'truth.tum').is_file()
