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

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped

from debris_scanner.core.geometry import Array, from_pose_vector, to_pose_vector
from debris_scanner.core.results import ClosureRecord
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import key_values
from debris_scanner.nodes.lifecycle.stage import StageNode
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import ClosureTransform, closure_message
from msg_adapters.records import check_values, read_checks, read_record, record_values
from msg_adapters.stamps import header_message

_POSE = 'T_from_to'


def candidates_message(closures: Sequence[Closure]) -> DiagnosticArray:
    """The hypotheses of one key frame, at least one, with their evidence."""
    statuses = [
        DiagnosticStatus(
            level=DiagnosticStatus.OK if c.accepted else DiagnosticStatus.WARN,
            name='closure',
            message=c.why,
            values=key_values(record_values(c.record) | _pose_value(c) | check_values(c.checks)),
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
        T = _read_pose(values.get(_POSE, ''))
        checks = read_checks(values)
        record = read_record(ClosureRecord, values, why=status.message, T_from_to=T, checks=checks)
        if not 0 <= record.probability <= 1:
            raise MalformedMessage(f'a closure hypothesis of probability {record.probability}')
        records.append(record)
    return records


def _pose_value(closure: Closure) -> dict[str, str]:
    """The registered pose as seven numbers with every digit; nothing where there is none."""
    T = closure.T_from_to
    return {} if T is None else {_POSE: ' '.join(map(repr, to_pose_vector(T).tolist()))}


def _read_pose(text: str) -> Array | None:
    if not text:
        return None
    try:
        return from_pose_vector(np.array([float(x) for x in text.split()]))
    except ValueError as error:
        raise MalformedMessage(f'{_POSE} of a closure hypothesis: {error}') from None


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
            pair = f'{c.from_stamp_ns} - {c.to_stamp_ns}'
            text = f'closure {pair}: probability {c.probability:.2f}, {verdict}: {c.why}'
            if c.accepted:  # rclpy allows one severity per line of code
                self._node.get_logger().info(text)
            else:  # hundreds a scan; closure_candidates and summary.json have them all
                self._node.get_logger().debug(text)
            self._node.diagnostics.counts[verdict] += 1
            if c.accepted and c.T_from_to is not None:
                transform = ClosureTransform(c.from_stamp_ns, c.to_stamp_ns, c.T_from_to)
                self.closures.publish(closure_message(transform))
