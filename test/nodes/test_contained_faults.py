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

"""An exception at each stage of a live scan, in one run: each costs its frame, and no node ends."""

import pytest
from live_runs import ROOT, LiveRun

pytestmark = [pytest.mark.ros, pytest.mark.slow]
FRAMES = [  # each loses one
    'debris_scanner.nodes.inputs.sensor_input:FrameDecoder.image:10',
    'debris_scanner.sensing.preprocessing:Preprocessor.process:15',
    'debris_scanner.tracking.odometry:Odometry.process:20',
    'debris_scanner.back_end:BackEnd._add_frame:25',
]
PUBLISHED = 'debris_scanner.nodes.publishing.odometry_publisher:OdometryPublisher.publish:30'
OTHERS = [
    'debris_scanner.mapping.closures:ClosureDetector.add:12',
    'debris_scanner.modelling.model_builder:ModelBuilder.generate:2',  # the first call is of the warm-up
]


@pytest.mark.parametrize('composed', [False, True])
def test_an_exception_at_each_stage_costs_its_frame_and_no_more(tmp_path, brief_bag, composed):
    words = ' '.join([*FRAMES, PUBLISHED, *OTHERS])
    live = LiveRun(
        tmp_path / 'out',
        *('--bag', brief_bag, *(['--composed'] if composed else [])),
        PYTHONPATH=f'{ROOT / "test" / "raising"}:{ROOT}',
        RAISE_AT=words,
        RAISED=str(tmp_path),
    )
    assert live.end() == 0, live.errors
    assert {p.name for p in tmp_path.iterdir()} >= {str(k) for k in range(len(words.split()))}
    assert 'was restarted' not in live.errors and 'ended (' not in live.errors
    summary = live.summary
    assert (summary['result'], summary['reason']) == ('model', None)
    assert summary['errors'] == {'ZeroDivisionError': len(words.split())}
    frames, rejected = summary['frames'], summary['frames']['rejected']
    # composed, the frame that is not published goes on to the back end all the same
    assert rejected['error'] == len(FRAMES) + (0 if composed else 1)
    assert set(rejected) <= {'error', 'shed', 'not_registered'}
    assert frames['read'] == 45 == frames['used'] + sum(rejected.values())
    nodes = ('scanner',) if composed else ('preprocess', 'odometry', 'closure', 'graph')
    logs = [(live.out / 'logs' / f'{node}.log').read_text() for node in nodes]
    assert [log.count('Traceback') for log in logs] == [1] * len(nodes)
