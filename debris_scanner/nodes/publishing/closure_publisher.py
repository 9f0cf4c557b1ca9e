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

"""Topics ``closures``, the accepted ones, and ``closure_candidates``, every hypothesis with its evidence."""

from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped

from debris_scanner.core.results import ClosureRecord
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import key_values
from debris_scanner.nodes.lifecycle.stage import StageNode
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import ClosureTransform, closure_message
from msg_adapters.records import read_record, record_values
from msg_adapters.stamps import header_message


def candidates_message(closures: Sequence[Closure]) -> DiagnosticArray:
    """The hypotheses of one key frame, at least one, with their evidence."""
    statuses = [
        DiagnosticStatus(
            level=DiagnosticStatus.OK if c.accepted else DiagnosticStatus.WARN,
            name='closure',
            message=c.why,
            values=key_values(record_values(c.record)),
        )
        for c in closures
    ]
    return DiagnosticArray(header=header_message(closures[0].to_stamp_ns, ''), status=statuses)


def read_candidates(msg: DiagnosticArray) -> list[ClosureRecord]:
    """The inverse of :func:`candidates_message`.

    Raises:
        MalformedMessage: a status is no hypothesis.
    """
    records = []
    for status in msg.status:
        values = {item.key: item.value for item in status.values}
        record = read_record(ClosureRecord, values, why=status.message)
        if not 0 <= record.probability <= 1:
            raise MalformedMessage(f'a closure hypothesis of probability {record.probability}')
        records.append(record)
    return records


class ClosurePublisher:
    """Publishes, logs and counts closure hypotheses."""

    def __init__(self, node: StageNode) -> None:
        self._node = node
        self.closures = node.create_publisher(TransformStamped, 'closures', qos.kept())
        self.candidates = node.create_publisher(DiagnosticArray, 'closure_candidates', qos.kept())

    def publish(self, closures: Sequence[Closure]) -> None:
        """Publish the hypotheses of one key frame, if there are any."""
        if not closures:
            return
        self.candidates.publish(candidates_message(closures))
        for c in closures:
            verdict = 'accepted' if c.accepted else 'refused'
            self._node.get_logger().info(
                f'closure {c.from_stamp_ns} - {c.to_stamp_ns}: probability {c.probability:.2f}, '
                f'{verdict}: {c.why}'
            )
            self._node.diagnostics.counts[verdict] += 1
            if c.accepted:
                transform = ClosureTransform(c.from_stamp_ns, c.to_stamp_ns, c.T_from_to)
                self.closures.publish(closure_message(transform))
