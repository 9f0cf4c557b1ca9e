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

"""Topics ``closures``, the accepted ones, and ``closure_candidates``, every hypothesis with its numbers."""

from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped

from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes import qos
from debris_scanner.nodes.closure_messages import candidates_message
from debris_scanner.nodes.stage import StageNode
from msg_adapters.poses import Closure as ClosureTransform
from msg_adapters.poses import closure_message


class ClosurePublisher:
    """Publishes, logs and counts what a key frame raised."""

    def __init__(self, node: StageNode) -> None:
        self._node = node
        self.closures = node.create_publisher(TransformStamped, 'closures', qos.kept())
        self.candidates = node.create_publisher(DiagnosticArray, 'closure_candidates', qos.kept())

    def publish(self, closures: Sequence[Closure]) -> None:
        """The hypotheses of one key frame; none are fine too."""
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
