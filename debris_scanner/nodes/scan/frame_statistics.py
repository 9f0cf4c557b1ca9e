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

"""Where every frame went, over all processes: what summary.json says of frames, drops and timing."""

from collections import Counter, deque

from debris_scanner.core.stamps import SensorClock
from debris_scanner.core.timing import WINDOW, StageTimer
from debris_scanner.nodes.inputs.sensor_input import LOST_IN_TRANSPORT
from debris_scanner.nodes.lifecycle.diagnostics import Report

LATENCY = 'latency_odometry'  # sensor stamp to published odometry
MOST_REPORTS = 100  # nodes whose reports are kept; whoever sends more is none of ours
SOURCES = ('sim_kinect', 'play_bag')
_STAGES = ('preprocess', 'odometry', 'closure')


class FrameStatistics:
    """Counts of this node, joined with the last report of every other."""

    def __init__(self) -> None:
        self.clock = SensorClock()
        self._published: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self.reports: dict[str, Report] = {}
        self._former: dict[str, Counter[str]] = {}  # drops that processes counted which were restarted
        self.reset()

    def reset(self) -> None:
        """A new scan; earlier reports count the old one."""
        self.incomplete = 0  # accepted frames of which a part never came
        self.first_ns: int | None = None  # stamp of the scan's first frame
        self.reports.clear()
        self._former.clear()

    def report(self, report: Report) -> None:
        """The latest of a stage."""
        if report.stage not in self.reports and len(self.reports) >= MOST_REPORTS:
            return
        last = self.reports.get(report.stage)
        if last is not None and last.values.get('process') != report.values.get('process'):
            former = self._former.setdefault(report.stage, Counter())
            former.update(last.rejected)
            former[LOST_IN_TRANSPORT] += last.counts.get('lost', 0)
        self.reports[report.stage] = report
        if report.stage in SOURCES:
            self.clock.learn(report.values)

    def odometry_published(self, stamp_ns: int, at_ns: int) -> None:
        """When the odometry of a frame was published."""
        self._published.append((stamp_ns, at_ns))

    def rejected(self, arrived: int, lost_here: int) -> dict[str, int]:
        """Frames dropped on their way here, by reason, over all stages.

        Args:
            arrived: frames that came here, registered or not.
            lost_here: statuses of frames that this node never got.
        """
        total: Counter[str] = Counter()
        lost = lost_here + self.incomplete
        for stage in _STAGES[:2]:
            if stage in self.reports:
                total.update(self._former.get(stage, {}))
                total.update(self.reports[stage].rejected)
                lost += self.reports[stage].counts.get('lost', 0)
        lost += max(0, self.sent - arrived - sum(total.values()) - lost)
        total[LOST_IN_TRANSPORT] += lost
        return {reason: n for reason, n in total.items() if n}

    def timing(self, own: StageTimer) -> dict[str, dict[str, float]]:
        """Stages of all processes."""
        timing: dict[str, dict[str, float]] = {}
        for stage in _STAGES:
            if stage in self.reports:
                rows = self.reports[stage].timing
                timing |= {
                    name if name not in timing else f'{stage}_{name}': row for name, row in rows.items()
                }
        latencies = StageTimer()
        for stamp_ns, at_ns in tuple(self._published):  # the executor goes on adding
            if self.first_ns is not None and stamp_ns < self.first_ns:  # of the scan before
                continue
            age = self.clock.age_s(stamp_ns, at_ns)
            if age is not None:
                latencies.add(LATENCY, age)
        return timing | own.summary() | latencies.summary()

    @property
    def sent(self) -> int:
        """Frames that a source which has come to its end says it sent; 0 where nobody knows."""
        for source in SOURCES:
            report = self.reports.get(source)
            if report is not None and report.values.get('finished') == '1':
                return report.counts.get('published', 0)
        return 0
