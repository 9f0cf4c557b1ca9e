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

"""Accounts for every frame over all processes: the frames, drops and timing of summary.json."""

import threading
from collections import Counter, deque
from pathlib import Path

from debris_scanner.core.stamps import SensorClock
from debris_scanner.core.timing import WINDOW, StageTimer
from debris_scanner.faults import counted
from debris_scanner.io.outcome import LOST_IN_TRANSPORT
from debris_scanner.nodes.lifecycle.diagnostics import Report

LATENCY = 'latency_odometry'  # sensor stamp to published odometry
MOST_REPORTS = 100  # nodes whose reports are kept; bounds memory if another node floods the topic
SOURCES = ('sim_kinect', 'play_bag')
_STAGES = ('preprocess', 'odometry', 'closure')


class FrameStatistics:
    """Counts of this node, combined with the latest report of every other.

    Args:
        journals: folder where the stages note their exceptions; None: their reports alone tell of them.
    """

    def __init__(self, journals: Path | None = None) -> None:
        self._journals = journals
        self.clock = SensorClock()
        self._lock = threading.Lock()  # the executor takes reports while the worker makes a result of them
        self._published: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self.reports: dict[str, Report] = {}
        self._former: dict[str, Counter[str]] = {}  # drops that earlier processes of a stage counted
        self.reset()

    def reset(self) -> None:
        """Start a new scan; earlier reports count the old one."""
        with self._lock:
            self._reset()

    def _reset(self) -> None:
        self.incomplete = 0  # accepted frames of which a message never arrived
        self.first_ns: int | None = None  # stamp of the scan's first frame
        self.reports.clear()
        self._former.clear()

    def report(self, report: Report) -> None:
        """Take the latest report of a stage."""
        with self._lock:
            self._report(report)

    def _report(self, report: Report) -> None:
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
        """Note when the odometry of a frame was published."""
        self._published.append((stamp_ns, at_ns))

    def rejected(self, arrived: int, lost_here: int) -> dict[str, int]:
        """Frames dropped before this node, by reason, over all stages.

        Args:
            arrived: frames that arrived here, registered or not.
            lost_here: statuses of frames that this node never received.
        """
        with self._lock:
            return self._rejected(arrived, lost_here)

    def _rejected(self, arrived: int, lost_here: int) -> dict[str, int]:
        total: Counter[str] = Counter()
        lost = lost_here + self.incomplete
        for stage in _STAGES[:2]:
            if (report := self.reports.get(stage)) is not None:
                total.update(self._former.get(stage, {}))
                total.update(report.rejected)
                lost += report.counts.get('lost', 0)
        lost += max(0, self.sent - arrived - sum(total.values()) - lost)
        total[LOST_IN_TRANSPORT] += lost
        return {reason: n for reason, n in total.items() if n}

    @property
    def errors(self) -> Counter[str]:
        """Exceptions in the other stages, by type."""
        total: Counter[str] = Counter()
        for stage in _STAGES:
            report = self.reports.get(stage)
            told = Counter[str]() if report is None else Counter(report.errors)
            total += told if self._journals is None else told | counted(self._journals, stage)
        return total

    def told(self, key: str) -> str:
        """What is odd about the sensor's input, by the key of the report."""
        report = self.reports.get(_STAGES[0])
        return '' if report is None else report.values.get(key, '')

    def timing(self, own: StageTimer) -> dict[str, dict[str, float]]:
        """Timing of the stages in all processes."""
        timing: dict[str, dict[str, float]] = {}
        for stage in _STAGES:
            if (report := self.reports.get(stage)) is not None:
                timing |= {
                    name if name not in timing else f'{stage}_{name}': row
                    for name, row in report.timing.items()
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
        """Number of frames that a finished source reports as sent; 0 if unknown."""
        for source in SOURCES:
            report = self.reports.get(source)
            if report is not None and report.values.get('finished') == '1':
                return report.counts.get('published', 0)
        return 0
