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

"""kill -9 of each node at any moment: it is restarted and continues; the scan is not lost."""

import time

import pytest
from live_runs import ROOT, LiveRun, holds_the_bounds

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.faults]
SCAN = ('--simulate', 'shuttle_stack', '--spin', 0.7, '--track-seconds', 5)


@pytest.mark.parametrize('node', ['odometry', 'closure', 'graph', 'preprocess', 'scanner'])
@pytest.mark.parametrize('moment', ['scanning', 'generating', 'tracking'])
def test_a_killed_node_goes_on(tmp_path, node, moment):
    live = LiveRun(tmp_path / 'out', *SCAN, *(['--composed'] if node == 'scanner' else []))
    if moment == 'scanning':
        live.until_said('scanning')
        time.sleep(6)
    else:
        live.until_said(f'{moment} ')
    live.kill(node)
    assert live.end() == 0, live.errors
    assert f'{node} ended (signal 9' in live.errors
    assert live.errors.count('was restarted') == 1
    frames = live.summary['frames']
    # odometry, closure and graph catch up from disk; what the sensor sent to nobody is gone, and of the
    # composed scanner also what waited for its builder
    lost = frames['rejected'].get('lost_in_transport', 0)
    assert lost <= {'preprocess': 25, 'scanner': 60}.get(node, 2), frames
    assert frames['used'] + sum(frames['rejected'].values()) == frames['read']
    assert frames['used'] > 100
    holds_the_bounds(live.metrics)
    assert not (live.out / 'journal').exists()


def test_all_nodes_killed_one_after_the_other(tmp_path):
    live = LiveRun(tmp_path / 'out', *SCAN)
    live.until_said('scanning')
    for node in ('graph', 'closure', 'odometry'):
        time.sleep(3)
        live.kill(node)
    assert live.end() == 0, live.errors
    assert live.errors.count('was restarted') == 3
    holds_the_bounds(live.metrics)


@pytest.mark.parametrize('composed', [False, True])
def test_exceptions_of_killed_nodes_are_counted(tmp_path, brief_bag, composed):
    raising = [
        'debris_scanner.sensing.preprocessing:Preprocessor.process:5',
        'debris_scanner.tracking.odometry:Odometry.process:6',
        'debris_scanner.mapping.closures:ClosureDetector.add:12',  # some calls are of the warm-up
        'debris_scanner.back_end:BackEnd._add_frame:7',
    ]
    live = LiveRun(
        tmp_path / 'out',
        *('--bag', brief_bag, *(['--composed'] if composed else [])),
        PYTHONPATH=f'{ROOT / "test" / "raising"}:{ROOT}',
        RAISE_AT=' '.join(raising),
        RAISED=str(tmp_path),
    )
    live.until(lambda: all((tmp_path / str(k)).exists() for k in range(len(raising))), 'the exceptions')
    for node in ['scanner'] if composed else ['graph', 'closure', 'odometry', 'preprocess']:
        live.kill(node)
    assert live.end() in (0, 3), live.errors  # the frames of the outage may be those that close the loop
    assert live.summary['errors'] == {'ZeroDivisionError': len(raising)}


@pytest.mark.parametrize('after_s', [0.0, 1.5, 4.0])
@pytest.mark.parametrize('owner', ['graph', 'scanner'])
def test_the_owner_is_killed_while_it_finishes(tmp_path, owner, after_s):
    live = LiveRun(tmp_path / 'out', *SCAN, *(['--composed'] if owner == 'scanner' else []))
    live.until_said('finishing')
    time.sleep(after_s)
    live.kill(owner)
    assert live.end() == 0, live.errors
    assert f'{owner} ended (signal 9' in live.errors
    assert live.errors.count('was restarted') == 1
    holds_the_bounds(live.metrics)
    assert not (live.out / 'journal').exists()


def test_a_killed_source_ends_the_scan_with_what_was_seen(tmp_path):
    live = LiveRun(tmp_path / 'out', *SCAN)
    live.until_said('tracking')
    live.kill('sim_kinect')
    assert live.end() == 0, live.errors
    assert 'sim_kinect ended (signal 9' in live.errors
    assert live.summary['result'] == 'model'
