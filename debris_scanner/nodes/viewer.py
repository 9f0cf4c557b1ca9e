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

"""Node ``viewer``: the scan in a browser, for those without RViz."""

import sys
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.parameters import ParameterError
from debris_scanner.nodes import qos
from debris_scanner.nodes.diagnostics import TOPIC, read_reports, throughput
from debris_scanner.nodes.parameters import declare, declare_live
from debris_scanner.nodes.process import run
from debris_scanner.nodes.scene_messages import FRAMES, SceneMessages
from debris_scanner.nodes.stage import StageNode
from debris_scanner.viewer.scene import ScanScene
from debris_scanner.viewer.server import LOOPBACK, PORT, ViewerError, open_server, url_of
from msg_adapters.errors import MalformedMessage

ODOMETRY, POINTS = 'odometry', 'target_points'
_RECENT = 10  # clouds that wait for their pose


class ViewerNode(StageNode):
    """Keeps the newest message of each topic; draws what is new a few times a second, if somebody looks."""

    def __init__(self) -> None:
        super().__init__('viewer')
        host = declare(self, 'host', LOOPBACK, 'address to serve on; 0.0.0.0 lets the whole network look')
        port = declare(self, 'port', PORT, 'port to serve on; 0 takes a free one', 0, 65535)
        rate = declare(self, 'max_rate_hz', 5.0, 'pictures a second at most', 0.1, 30.0)
        points = declare_live(self, 'max_points', 20_000, 'points of a cloud drawn at most', 100, 10**6)
        try:
            self._server = open_server(host, port)
        except ViewerError as error:
            raise ParameterError(str(error)) from None
        self._scene = SceneMessages(ScanScene(self._server, FRAMES), points)
        self._newest: dict[str, Any] = {}
        self._clouds: deque[PointCloud2] = deque(maxlen=_RECENT)
        self._posed = False  # odometry has spoken
        self._drawn = throughput(self.diagnostics.counts, 'drawn')
        newest = qos.sensor_input(qos.BEST_EFFORT, 5)
        self._keep(PointCloud2, POINTS, newest)
        self._keep(Odometry, ODOMETRY, newest)
        self._keep(MarkerArray, 'graph_markers', qos.latched())
        self._keep(PointCloud2, 'model', qos.latched())
        self._keep(Marker, 'model_mesh', qos.latched())
        self._keep(String, 'state', qos.latched())
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.create_timer(1.0 / rate, self._draw)
        self.get_logger().info(f'the scan is shown at {url_of(self._server)}')

    def diagnostic_values(self) -> dict[str, Any]:
        """Where it is shown, who looks, and how often it is drawn."""
        clients = len(self._server.get_clients())
        return {'url': url_of(self._server), 'clients': clients, 'drawn_per_second': self._drawn()}

    def reset(self) -> None:
        """Take the old scan down."""
        super().reset()
        self._clouds.clear()
        self._newest.clear()
        self._scene.clear()

    def close(self) -> None:
        """End the server."""
        super().close()
        self._server.stop()

    def _keep(self, msg_type: type, topic: str, profile: Any) -> None:
        """Subscribe; what comes waits to be drawn, and is replaced by what comes after it."""

        def keep(msg: Any) -> None:
            self._newest[topic] = msg
            if topic == POINTS:
                self._clouds.append(msg)

        self.create_subscription(msg_type, topic, keep, profile)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self._scene.note(report)
                self._newest[TOPIC] = msg

    def _draw(self) -> None:
        if not self._server.get_clients():  # what is new waits for somebody to look
            return
        news, self._newest = self._newest, {}
        self._posed |= ODOMETRY in news
        for topic, msg in news.items():
            if topic == POINTS and self._posed:
                continue  # clouds are drawn with their poses
            try:
                with self.timer.stage(topic.strip('/')):
                    self._draw_one(topic, msg)
            except MalformedMessage as error:
                self.diagnostics.rejected['malformed'] += 1
                self.get_logger().warning(f'message on {topic} not shown: {error}', throttle_duration_sec=5.0)
        self.diagnostics.counts['drawn'] += bool(news)

    def _draw_one(self, topic: str, msg: Any) -> None:
        if topic == TOPIC:
            self._scene.diagnostics()
        elif topic == ODOMETRY:
            self._scene.odometry(msg, tuple(self._clouds))
        else:
            getattr(self._scene, topic)(msg)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner viewer``."""
    return run(ViewerNode, args)


if __name__ == '__main__':
    sys.exit(main())
