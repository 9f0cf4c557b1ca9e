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

"""Where every frame went, over all processes and those that were restarted."""

import time

from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import Faults
from debris_scanner.nodes.lifecycle.diagnostics import Report
from debris_scanner.nodes.scan.frame_statistics import LATENCY, FrameStatistics


def report(stage, **kwargs):
    return Report(stage, '/', 0, b'\0', '', kwargs.pop('values', {}), **kwargs)


class TestFrameStatistics:
    def test_every_frame_of_a_finished_source_is_accounted_for(self):
        statistics = FrameStatistics()
        statistics.incomplete = 1
        arrived = 83
        statistics.report(report('preprocess', rejected={'no_target': 4}, counts={'lost': 2}))
        statistics.report(report('odometry', counts={'lost': 1}))
        assert statistics.rejected(arrived, lost_here=1) == {'no_target': 4, 'lost_in_transport': 5}
        source = {'counts': {'published': 100}}
        statistics.report(report('sim_kinect', values={'finished': '0'}, **source))
        assert statistics.rejected(arrived, 1)['lost_in_transport'] == 5, (
            'frames still on their way are not lost'
        )
        statistics.report(report('sim_kinect', values={'finished': '1'}, **source))
        rejected = statistics.rejected(arrived, 1)
        assert rejected['lost_in_transport'] == 13
        assert arrived + sum(rejected.values()) == 100

    def test_the_hint_is_that_of_the_node_that_receives_the_sensor(self):
        statistics = FrameStatistics()
        assert statistics.told('hint') == ''
        statistics.report(report('preprocess', values={'hint': 'all stamps are 0'}))
        statistics.report(report('odometry', values={}))
        assert statistics.told('hint') == 'all stamps are 0'
        statistics.reset()
        assert statistics.told('hint') == ''

    def test_what_a_killed_process_counted_is_not_forgotten(self):
        statistics = FrameStatistics()
        for process, dropped in (('11', 4), ('11', 5), ('12', 0), ('12', 2)):
            statistics.report(
                report(
                    'preprocess',
                    values={'process': process},
                    rejected={'no_target': dropped},
                    counts={'lost': 1},
                )
            )
        assert statistics.rejected(0, 0) == {'no_target': 7, 'lost_in_transport': 2}
        statistics.reset()
        assert statistics.rejected(0, 0) == {}

    def test_exceptions_are_those_of_all_processes_of_a_stage(self, tmp_path):
        killed, statistics = Faults(lambda _: None), FrameStatistics(tmp_path)
        killed.remember(tmp_path, 'odometry')
        killed.note(ValueError(), 'a frame')  # and is killed before it reports it
        assert statistics.errors == {'ValueError': 1}
        statistics.report(report('closure', errors={'ValueError': 1}))
        statistics.report(report('odometry', errors={'ValueError': 1}))  # the next process goes on from it
        assert statistics.errors == {'ValueError': 2}

    def test_nothing_dropped_is_no_row(self):
        assert FrameStatistics().rejected(9, 0) == {}

    def test_timing_of_all_processes_and_the_latency(self):
        statistics, own = FrameStatistics(), StageTimer()
        row = {'count': 1, 'p50_ms': 1.0, 'p99_ms': 1.0}
        statistics.report(report('odometry', timing={'receive': row, 'view': row}))
        statistics.report(report('closure', timing={'receive': row}))
        own.add('generation', 2.0)
        now = time.time_ns()
        for k in range(3):
            statistics.odometry_published(now + k * 10**8, now + k * 10**8 + 25_000_000)
        timing = statistics.timing(own)
        assert timing.keys() == {'receive', 'view', 'closure_receive', 'generation', LATENCY}
        assert timing[LATENCY] == {'count': 3, 'p50_ms': 25.0, 'p99_ms': 25.0}

    def test_a_new_scan_forgets_the_latencies_of_the_one_before_only(self):
        statistics = FrameStatistics()
        now = time.time_ns()
        for k in range(4):
            statistics.odometry_published(now + k, now + 1_000_000)
        statistics.reset()  # comes late, when two frames of the new scan are there already
        statistics.first_ns = now + 2
        assert statistics.timing(StageTimer())[LATENCY]['count'] == 2

    def test_a_recording_without_its_player_has_no_latency(self):
        statistics = FrameStatistics()
        statistics.odometry_published(1_000_000_000, time.time_ns())
        assert statistics.timing(StageTimer()) == {}
