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

"""Diagnostics: the published status, and reports read back from an array."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from debris_scanner.nodes.lifecycle.diagnostics import (
    ERROR,
    HARDWARE_ID,
    OK,
    WARN,
    Diagnostics,
    key_values,
    read_reports,
    together,
)


class StubNode:
    """What Diagnostics needs of a node; keeps what is published."""

    def __init__(self, name):
        self._name = name
        self.published = []

    def create_publisher(self, *_):
        return self

    def create_timer(self, *_):
        return None

    def get_namespace(self):
        return self._name.rpartition('/')[0] or '/'

    def get_fully_qualified_name(self):
        return self._name

    def get_clock(self):
        return self

    def now(self):
        return self

    def to_msg(self):
        return DiagnosticArray().header.stamp

    def publish(self, message):
        self.published.append(message)


def test_a_status_is_named_by_node_and_stage_and_read_back():
    problems = []
    node = StubNode('/left/tracker')
    diagnostics = Diagnostics(node, 'odometry', problem=lambda: problems[0] if problems else None)
    diagnostics.counts['received'] += 2
    diagnostics.publish()
    problems.append((WARN, 'the target is lost'))
    diagnostics.publish()
    first, second = (message.status[0] for message in node.published)
    assert first.name == 'left/tracker: odometry'
    assert first.hardware_id == HARDWARE_ID
    assert (first.level, first.message) == (OK, 'running')
    assert (second.level, second.message) == (WARN, 'the target is lost')
    (report,) = read_reports(node.published[1])
    assert (report.stage, report.namespace, report.counts) == ('odometry', '/left', {'received': 2})


def test_reports_are_read_and_those_of_others_ignored():
    values = {
        'stage': 'preprocess',
        'namespace': '/a',
        'unmatched': '',
        'count.received': 12,
        'rejected.no_target': 3,
        'timing.isolate.count': 9,
        'timing.isolate.p50_ms': 1.25,
    }
    ours = DiagnosticStatus(hardware_id=HARDWARE_ID, message='running', values=key_values(values))
    broken = DiagnosticStatus(
        hardware_id=HARDWARE_ID, values=key_values(values | {'count.received': 'twelve'})
    )
    others = DiagnosticStatus(hardware_id='gps', values=[KeyValue(key='stage', value='preprocess')])
    (report,) = read_reports(DiagnosticArray(status=[others, broken, ours]))
    assert (report.stage, report.namespace, report.ready) == ('preprocess', '/a', True)
    assert report.counts == {'received': 12}
    assert report.rejected == {'no_target': 3}
    assert report.timing == {'isolate': {'count': 9, 'p50_ms': 1.25}}


def test_one_problem_does_not_hide_another():
    assert together(None, (WARN, '')) is None
    shedding, still = (WARN, 'overloaded: 5 of 30'), (WARN, 'background in the box')
    assert together(shedding, None, still) == (WARN, 'overloaded: 5 of 30; background in the box')
    assert together(still, (ERROR, 'the disk is full'))[0] == ERROR
