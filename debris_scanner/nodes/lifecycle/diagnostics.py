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

"""/diagnostics of every node, once a second: level and message, counters, drops by reason, stage timings.

The graph node collects them for summary.json, ``debris-scan live`` for its progress line. diagnostic_updater
is not on PyPI; this module keeps its conventions: topic, period, and status names such as ``odometry:
odometry``.
"""

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import psutil
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher

from debris_scanner.core.timing import StageTimer
from msg_adapters.stamps import read_stamp

TOPIC = '/diagnostics'
HARDWARE_ID = 'debris_scanner'
HINT, UNITS = 'hint', 'units'  # keys of what is odd about the sensor's input, and about its unit
ACTIVE = 'active'  # lifecycle state of a managed node that processes messages
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

Problem = tuple[bytes, str]

REMIND_S = 60.0  # between two lines of the log about one problem
SETTLING_S = 5.0  # a problem that is gone by then needs no line


def together(*problems: Problem | None) -> Problem | None:
    """All problems as one, of the worst level: one that lasts must not hide another.

    One without text is none.
    """
    told = [problem for problem in problems if problem is not None and problem[1]]
    return (max(level for level, _ in told), '; '.join(text for _, text in told)) if told else None


class Diagnostics:
    """Publishes the status of one node.

    Args:
        node: that publishes.
        stage: name of the stage, independent of the node's name.
        timer: its stage timings.
        values: called for further key-values, each second.
        problem: called for the level and message of a problem; returns None if there is none.
    """

    def __init__(
        self,
        node: Node,
        stage: str,
        timer: StageTimer | None = None,
        values: Callable[[], dict[str, Any]] | None = None,
        problem: Callable[[], Problem | None] | None = None,
    ) -> None:
        self._node = node
        self.stage = stage
        self._timer = timer
        self._values = values
        self._problem = problem
        self._outputs: dict[str, tuple[Publisher, int]] = {}
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, 10)
        self._told_s = time.monotonic() - REMIND_S + SETTLING_S  # when a problem was logged
        self.counts: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()  # exceptions, by type; whoever counts them sets it
        node.create_timer(1.0, self.publish)

    def expect_subscribers(self, number: int = 1, **outputs: Publisher) -> None:
        """Add outputs that need this number of subscribers before the stage counts as ready."""
        self._outputs |= {name: (publisher, number) for name, publisher in outputs.items()}

    def forget_subscribers(self) -> None:
        """Forget all outputs: they have been destroyed."""
        self._outputs.clear()

    def reset(self) -> None:
        """Start all counts at zero."""
        self.counts.clear()
        self.rejected.clear()

    @property
    def unmatched(self) -> list[str]:
        """Outputs that lack a subscriber."""
        return [name for name, (out, n) in self._outputs.items() if out.get_subscription_count() < n]

    def publish(self) -> None:
        """Publish the status now; called each second."""
        level, message = (self._problem and self._problem()) or (OK, 'running')
        self._tell(level, message)
        values: dict[str, Any] = {
            'stage': self.stage,
            'namespace': self._node.get_namespace(),
            'process': os.getpid(),
            'unmatched': ' '.join(self.unmatched),
            'resident_mb': round(self._process.memory_info().rss / 1e6, 1),
            'cpu_percent': self._process.cpu_percent(),
        }
        values |= self._values() if self._values else {}
        # whole, while other threads go on counting
        values |= {f'count.{name}': n for name, n in self.counts.copy().items()}
        values |= {f'rejected.{reason}': n for reason, n in self.rejected.copy().items()}
        values |= {f'error.{kind}': n for kind, n in self.errors.copy().items()}
        for stage, row in (self._timer.summary() if self._timer else {}).items():
            values |= {f'timing.{stage}.{name}': number for name, number in row.items()}
        status = DiagnosticStatus(
            level=level,
            name=f'{self._node.get_fully_qualified_name().lstrip("/")}: {self.stage}',
            message=message,
            hardware_id=HARDWARE_ID,
            values=key_values(values),
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def _tell(self, level: bytes, message: str) -> None:
        """Log a problem that lasts, and again when it has lasted for long: few users look at diagnostics."""
        now_s = time.monotonic()
        if level == OK:
            self._told_s = now_s - REMIND_S + SETTLING_S
        elif now_s - self._told_s >= REMIND_S:
            self._told_s = now_s
            self._node.get_logger().warning(message)


@dataclass(frozen=True)
class Report:
    """A status that :class:`Diagnostics` published."""

    stage: str
    namespace: str
    stamp_ns: int
    level: bytes
    message: str
    values: dict[str, str]
    counts: dict[str, int] = field(default_factory=dict)
    rejected: dict[str, int] = field(default_factory=dict)
    errors: dict[str, int] = field(default_factory=dict)
    timing: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def ready(self) -> bool:
        """Whether the node is active, and all its outputs have subscribers."""
        return self.values.get('lifecycle', ACTIVE) == ACTIVE and not self.values.get('unmatched')


def read_reports(msg: DiagnosticArray) -> Iterator[Report]:
    """Reports of our nodes in an array; those of other packages are ignored."""
    for status in msg.status:
        values = {item.key: item.value for item in status.values}
        if status.hardware_id != HARDWARE_ID or 'stage' not in values:
            continue
        try:
            yield Report(
                values['stage'],
                values.get('namespace', '/'),
                read_stamp(msg.header.stamp),
                status.level,
                status.message,
                values,
                _counts(values, 'count.'),
                _counts(values, 'rejected.'),
                _counts(values, 'error.'),
                _timing(values),
            )
        except ValueError:  # malformed
            continue


def key_values(values: dict[str, Any]) -> list[KeyValue]:
    """Key-value messages; floats with every digit."""
    return [KeyValue(key=key, value=repr(v) if isinstance(v, float) else str(v)) for key, v in values.items()]


def throughput(counts: Counter[str], name: str) -> Callable[[], float]:
    """A function that returns the growth of a counter per second since its last call."""
    last_time, last_count = time.monotonic(), counts[name]

    def rate() -> float:
        nonlocal last_time, last_count
        now, count = time.monotonic(), counts[name]
        grown = max(0, count - last_count) / max(now - last_time, 1e-3)
        last_time, last_count = now, count
        return round(grown, 2)

    return rate


def _counts(values: dict[str, str], prefix: str) -> dict[str, int]:
    return {key.removeprefix(prefix): int(n) for key, n in values.items() if key.startswith(prefix)}


def _timing(values: dict[str, str]) -> dict[str, dict[str, float]]:
    timing: dict[str, dict[str, float]] = {}
    for key, value in values.items():
        if key.startswith('timing.'):
            _, stage, name = key.split('.')
            timing.setdefault(stage, {})[name] = int(value) if name == 'count' else float(value)
    return timing
