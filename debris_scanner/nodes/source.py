"""What the simulator and the player have in common: a node that publishes a recording in real time."""

import threading
from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.publisher import Publisher

from debris_scanner.nodes import qos
from debris_scanner.nodes.diagnostics import TOPIC, read_reports
from debris_scanner.nodes.pacing import Due, Pacer, wait_for
from debris_scanner.nodes.parameters import declare
from debris_scanner.nodes.stage import StageNode

_SETTLE_S = 0.3  # the subscriber may still be finding us when we have found it
_FLUSH_S = 0.5  # the last message leaves before its writer does


class SourceNode(StageNode):
    """Waits for subscribers, publishes its series, says so in its diagnostics, and ends."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._wait_s = declare(
            self, 'wait_for_subscribers', 30.0, 'how long to wait for them before playing to nobody, s', 0.0
        )
        self._stay = declare(self, 'stay', False, 'go on living after the end, with its counts to be read')
        stages = declare(
            self, 'wait_for_stages', '', 'nodes that must have found each other too, names by spaces'
        )
        self._waiting_for = set(stages.split())
        if self._waiting_for:
            self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self._inputs: tuple[Publisher, ...] = ()
        self._pacer: Pacer | None = None
        self._flushed = False

    def play(self, series: Iterable[Due], publishers: tuple[Publisher, ...]) -> None:
        """Begin; all of the publishers must have found a subscriber."""
        self._inputs = publishers
        self._pacer = Pacer(series, self._wait)
        self.create_timer(0.1, self._look)
        self._pacer.start()

    def diagnostic_values(self) -> dict[str, Any]:
        """Frames sent, and whether those were all."""
        pacer = self._pacer
        if pacer is None:
            return {}
        return {'finished': int(pacer.finished), 'count.published': pacer.sent, 'count.late': pacer.late}

    def close(self) -> None:
        """Stop sending."""
        if self._pacer is not None:
            self._pacer.stop()
        super().close()

    def ended(self) -> None:
        """Called once, when the series has come to its end."""

    def reset(self) -> None:
        """A recording goes on; what it shows is for the others to scan anew."""

    def _wait(self, stop: threading.Event) -> bool:
        matched = wait_for(self._awaited, stop, self._wait_s)
        if stop.is_set():
            return False
        if not matched:
            missing = ' '.join(sorted(self._waiting_for)) or 'a subscriber'
            self.get_logger().warning(f'no sign of {missing} in {self._wait_s:.0f} s: playing regardless')
        return not stop.wait(_SETTLE_S)

    def _awaited(self) -> bool:
        return not self._waiting_for and all(p.get_subscription_count() for p in self._inputs)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.ready and report.namespace == self.get_namespace():
                self._waiting_for.discard(report.stage)

    def _look(self) -> None:
        pacer = self._pacer
        assert pacer is not None
        pacer.check()
        if not pacer.finished or self._flushed:
            return
        self._flushed = True
        self.get_logger().info(f'{pacer.sent} frames sent, {pacer.late} of them late')
        self.diagnostics.publish()
        self.ended()
        if not self._stay:
            self.create_timer(_FLUSH_S, self._finish)

    def _finish(self) -> None:
        self.finished = True
