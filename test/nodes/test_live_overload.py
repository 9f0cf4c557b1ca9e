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

"""A live scan that cannot keep up, beside busy loops: it stays near the present, and counts what it sheds."""

import numpy as np
import pytest
from live_runs import run, summary_of

from benchmarks.performance.live import busy_loops

SPEED = 6.0  # 60 frames a second


@pytest.mark.ros
@pytest.mark.timing
@pytest.mark.parametrize('options', [(), ('--composed',)], ids=['four processes', 'composed'])
def test_beside_busy_loops_latency_is_a_few_service_times(tmp_path, turn_bag, options):
    with busy_loops(2):
        done = run('live', '--bag', turn_bag, '--speed', SPEED, '--out', tmp_path, *options, timeout=280)
    assert done.returncode in (0, 3), done.stderr
    summary = summary_of(tmp_path)
    frames, timing = summary['frames'], summary['timing']
    assert frames['read'] == 150 == frames['used'] + sum(frames['rejected'].values())
    assert frames['rejected']['shed'] > 0
    assert frames['rejected'].get('lost_in_transport', 0) <= 5
    service_ms = sum(timing[stage]['p50_ms'] for stage in ('decode', 'isolate', 'normals', 'registration'))
    # queues of twenty frames made it some twenty times as long
    assert timing['latency_odometry']['p50_ms'] < 8 * service_ms + 100
    gaps_s = np.diff(np.loadtxt(tmp_path / 'odometry.tum')[:, 0]) / SPEED
    assert np.percentile(gaps_s, 90) < 8 * service_ms * 1e-3 + 0.1
