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

"""The node with which ``debris-scan live`` follows the scan, and asks its owner to finish."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, TOPIC, Report, read_reports

VIEWER = 'viewer'
DRIVERS = ('openni2_camera', 'freenect_camera')


@dataclass(frozen=True)
class Progress:
    """The progress of the scan, for one line."""

    state: str
    frames_per_second: float
    frames: int
    keyframes: int
    probability: float  # of the newest key frame closing a loop
    model: bool

    def __str__(self) -> str:
        return (
            f'{self.state or "starting":10s} {self.frames_per_second:5.1f} frames/s  '
            f'{self.frames:5d} frames  {self.keyframes:4d} key frames  closure {self.probability:.2f}'
        )


class Monitor:
    """A node in this process that subscribes to diagnostics and to the scan's state.

    Args:
        owner: node that owns the scan and offers ``~/finish``.
    """

    def __init__(self, owner: str) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('live_monitor')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._reports: dict[str, Report] = {}
        self._state = ''
        self._moved_s = time.monotonic()
        self._received = 0
        self._node.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self._node.create_subscription(String, 'state', self._on_state, qos.latched())
        self._finish = self._node.create_client(Trigger, f'{owner}/finish')
        self._shown = self._node.create_client(Trigger, f'{VIEWER}/show_result')
        self._node.create_timer(0.1, lambda: None)  # so that spin_once returns

    def spin(self, seconds: float) -> None:
        """Process messages for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once()

    def ready(self, stages: Iterable[str]) -> bool:
        """Whether these stages have reported and found their subscribers."""
        return all(stage in self._reports and self._reports[stage].ready for stage in stages)

    def missing(self, stages: Iterable[str]) -> str:
        """What :meth:`ready` waits for."""
        return ', '.join(
            f'no report of {s}' if s not in self._reports else f'{s} has no subscriber on {unmatched}'
            for s in stages
            if (unmatched := '' if s not in self._reports else self._reports[s].values['unmatched'])
            or s not in self._reports
        )

    @property
    def idle_s(self) -> float | None:
        """Time since the last frame; None before the first."""
        return time.monotonic() - self._moved_s if self._received else None

    @property
    def input_problem(self) -> str:
        """The message of the first stage, about its input."""
        for stage in ('preprocess', 'scanner'):
            if stage in self._reports:
                return self._reports[stage].message
        return ''

    @property
    def driver_problem(self) -> str:
        """The error of a camera driver of ours; empty if there is none."""
        for driver in DRIVERS:
            report = self._reports.get(driver)
            if report is not None and report.level == ERROR:
                return f'{driver}: {report.message}'
        return ''

    @property
    def state(self) -> str:
        """The scan's state."""
        return self._state

    def value(self, stage: str, key: str) -> str:
        """The latest value that a stage reported under a key; empty before."""
        return self._reports[stage].values.get(key, '') if stage in self._reports else ''

    def progress(self) -> Progress:
        """The progress of the scan."""
        return Progress(
            self._state,
            float(self._value('frames_per_second', '0')),
            self._received,
            int(self._value('keyframes', '0')),
            float(self._value('best_probability', '0')),
            self._value('model', '0') == '1',
        )

    def ask_to_finish(self) -> 'rclpy.task.Future | None':
        """Call ``~/finish``; None while the service is not available."""
        return self._finish.call_async(Trigger.Request()) if self._finish.service_is_ready() else None

    def show_result(self, timeout_s: float) -> bool:
        """Have the viewer show the result; whether it did in time."""
        end = time.monotonic() + timeout_s
        answer = None
        while time.monotonic() < end:
            if answer is None and self._shown.service_is_ready():
                answer = self._shown.call_async(Trigger.Request())
            if answer is not None and answer.done():
                reply = answer.result()
                return reply is not None and bool(reply.success)
            self.spin(0.05)
        return False

    def close(self) -> None:
        """Shut ROS down."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _value(self, key: str, default: str) -> str:
        for report in self._reports.values():
            if key in report.values:
                return report.values[key]
        return default

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            self._reports[report.stage] = report
        received = max(
            (r.counts.get('received', 0) for s, r in self._reports.items() if s in ('preprocess', 'scanner')),
            default=0,
        )
        if received != self._received:
            self._received, self._moved_s = received, time.monotonic()

    def _on_state(self, msg: String) -> None:
        self._state = msg.data
