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

"""Node ``viewer``: shows the scan in a browser, without RViz.

:class:`SceneMessages` draws the messages of the scan into the scene; :class:`ViewerNode` keeps the newest of
each topic and draws them while somebody is watching.
"""

import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.parameters import ParameterError
from debris_scanner.core.turn import TurnWatch, turn_words
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import OK, TOPIC, Report, read_reports, throughput
from debris_scanner.nodes.lifecycle.parameters import declare, declare_live
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.publishing.estimates import SCANNING_FRAME, TARGET_FRAME
from debris_scanner.viewer.drawing import by_direction, lit, thinned
from debris_scanner.viewer.scene import ScanScene
from debris_scanner.viewer.server import LOOPBACK, PORT, ViewerError, open_server, url_of
from msg_adapters.clouds import field_names, read_cloud, read_fields
from msg_adapters.errors import MalformedMessage
from msg_adapters.markers import read_graph
from msg_adapters.models import read_mesh
from msg_adapters.poses import read_odometry, read_path
from msg_adapters.stamps import read_stamp

ODOMETRY, POINTS = 'odometry', 'target_points'
FRAMES = (SCANNING_FRAME, TARGET_FRAME)
MOST_TRIANGLES = 200_000
GHOST_AHEAD_NS = 10_000_000_000
_MOST_TEXT = 1000  # characters of a reading
_FORGOTTEN_S = 5.0  # a node without a report for so long is gone
_RECENT = 10  # clouds that wait for their pose
_INPUTS = ('preprocess', 'scanner')
_NORMALS = ('normal_x', 'normal_y', 'normal_z')


class SceneMessages:
    """Draws one message at a time; a malformed one raises MalformedMessage and changes nothing.

    Args:
        scene: to draw into.
        max_points: returns the largest number of points of a cloud.
    """

    def __init__(self, scene: ScanScene, max_points: Callable[[], int]) -> None:
        self._scene = scene
        self._max_points = max_points
        self._reports: dict[str, tuple[Report, float]] = {}
        self._turn = TurnWatch()

    def clear(self) -> None:
        """Start a new scan."""
        self._reports.clear()
        self._turn = TurnWatch()
        self._scene.clear()

    def odometry(self, msg: Odometry, clouds: Sequence[PointCloud2]) -> None:
        """Draw the pose, with the cloud of the same stamp, else the latest of those given."""
        pose = read_odometry(msg)
        frame = _known(pose.child_frame_id)
        if clouds:
            same = (c for c in clouds if read_stamp(c.header.stamp) == pose.stamp_ns)
            self.target_points(next(same, clouds[-1]))
        self._scene.show_pose(frame, pose.T_sensor_target)
        rate = np.rad2deg(np.linalg.norm(pose.twist[:3]))
        distance = np.linalg.norm(pose.T_sensor_target[:3, 3])
        self._scene.show_readings(
            {
                'Turning': f'{rate:.1f} °/s',
                'Turn': turn_words(self._turn.shown),
                'Distance': f'{distance:.3f} m',
            }
        )

    def watch(self, msg: Odometry) -> None:
        """Follow the turn; of every message, as it goes on also while nobody is watching."""
        try:
            pose = read_odometry(msg)
            self._turn.add(_known(pose.child_frame_id), pose.T_sensor_target[:3, :3])
        except MalformedMessage:
            return  # counted when it is drawn

    def target_points(self, msg: PointCloud2) -> None:
        """Draw the target as it is seen now, in its own colours or lit from the sensor."""
        cloud = read_cloud(msg)
        points, normals = cloud.xyz.reshape(-1, 3), _normals(msg)
        valid = np.flatnonzero(np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1))
        valid = valid[thinned(len(valid), self._max_points())]
        colours = lit(points[valid], normals[valid]) if cloud.rgb is None else cloud.rgb.reshape(-1, 3)[valid]
        self._scene.show_target(points[valid], colours)

    def graph_markers(self, msg: MarkerArray) -> None:
        """Draw the key frames, and the lines between them."""
        frame, nodes, edges, closures = read_graph(msg)
        self._scene.show_graph(_known(frame), nodes, edges, closures)
        self._scene.show_readings({'Key frames': str(len(nodes)), 'Loop edges': str(len(closures))})

    def model(self, msg: PointCloud2) -> None:
        """Draw the model's cloud; an empty one clears it."""
        frame, cloud = _known(msg.header.frame_id), read_cloud(msg)
        points = cloud.xyz.reshape(-1, 3)
        if not np.isfinite(points).all():
            raise MalformedMessage('the model has points that are not finite')
        if cloud.rgb is not None:
            colours = cloud.rgb.reshape(-1, 3)
        elif set(_NORMALS) <= set(field_names(msg)):
            colours = by_direction(_normals(msg))
        else:
            colours = np.full(points.shape, 200, np.uint8)
        some = thinned(len(points), 3 * self._max_points())
        self._scene.show_model(frame, points[some], colours[some], seen=cloud.rgb is not None)
        self._scene.show_readings({'Model': f'{len(points)} points' if len(points) else 'none yet'})

    def model_mesh(self, msg: Marker) -> None:
        """Draw the model's mesh; an empty one clears it."""
        frame = _known(msg.header.frame_id)
        if len(msg.points) > 3 * MOST_TRIANGLES:
            raise MalformedMessage(f'mesh of {len(msg.points) // 3} triangles: {MOST_TRIANGLES} at most')
        vertices, triangles = (None, None) if msg.action == Marker.DELETEALL else read_mesh(msg)
        if vertices is None or triangles is None:
            vertices, triangles = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
        self._scene.show_mesh(frame, vertices, triangles)

    def forecast(self, msg: Path) -> None:
        """Draw the model's ghost where it is expected in ten seconds."""
        ahead_ns = read_stamp(msg.header.stamp) + GHOST_AHEAD_NS
        later = (T for stamp_ns, T in read_path(msg) if stamp_ns >= ahead_ns)
        if (T_sensor_target := next(later, None)) is not None:
            self._scene.show_forecast(T_sensor_target)

    def state(self, msg: String) -> None:
        """Show the state of the scan."""
        self._scene.show_readings({'State': msg.data[:_MOST_TEXT]})

    def add_report(self, report: Report) -> None:
        """Keep the report of a node, for :meth:`diagnostics` to show."""
        self._reports[report.stage] = report, time.monotonic()

    def diagnostics(self) -> None:
        """Show the number of frames, and warnings and errors."""
        since = time.monotonic() - _FORGOTTEN_S
        self._reports = {stage: (r, at) for stage, (r, at) in self._reports.items() if at > since}
        reports = [report for report, _ in self._reports.values()]
        received = [r.counts.get('received', 0) for r in reports if r.stage in _INPUTS]
        rates = [r.values['frames_per_second'] for r in reports if 'frames_per_second' in r.values]
        if received:
            self._scene.show_readings(
                {'Frames': f'{received[0]}, {rates[0]} a second' if rates else f'{received[0]}'}
            )
        warnings = '\n'.join(f'{r.stage}: {r.message}' for r in reports if r.level != OK)
        self._scene.show_readings({'Remark': warnings[:_MOST_TEXT]})


class ViewerNode(StageNode):
    """Keeps the newest message of each topic; draws a few times a second while a client is connected."""

    def __init__(self) -> None:
        super().__init__('viewer')
        host = declare(self, 'host', LOOPBACK, 'address to serve on; 0.0.0.0 serves the whole network')
        port = declare(self, 'port', PORT, 'port to serve on; 0 takes a free one', 0, 65535)
        rate = declare(self, 'max_rate_hz', 5.0, 'largest number of updates per second', 0.1, 30.0)
        points = declare_live(
            self, 'max_points', 20_000, 'largest number of points drawn of a cloud', 100, 10**6
        )
        try:
            self._server = open_server(host, port)
        except ViewerError as error:
            raise ParameterError(str(error)) from None
        self._scene = SceneMessages(ScanScene(self._server, FRAMES), points)
        self._newest: dict[str, Any] = {}
        self._clouds: deque[PointCloud2] = deque(maxlen=_RECENT)
        self._posed = False  # odometry has published a pose
        self._drawn = throughput(self.diagnostics.counts, 'drawn')
        newest = qos.sensor_input(qos.BEST_EFFORT, 5)
        self._keep(PointCloud2, POINTS, newest)
        self._keep(Odometry, ODOMETRY, newest)
        self._keep(MarkerArray, 'graph_markers', qos.latched())
        self._keep(PointCloud2, 'model', qos.latched())
        self._keep(Marker, 'model_mesh', qos.latched())
        self._keep(String, 'state', qos.latched())
        self._keep(Path, 'forecast', qos.waiting())
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.create_timer(1.0 / rate, self._draw)
        self.get_logger().info(f'the scan is shown at {url_of(self._server)}')

    def diagnostic_values(self) -> dict[str, Any]:
        """Address, number of clients, and updates per second."""
        clients = len(self._server.get_clients())
        return {'url': url_of(self._server), 'clients': clients, 'drawn_per_second': self._drawn()}

    def reset(self) -> None:
        """Clear the old scan."""
        super().reset()
        self._clouds.clear()
        self._newest.clear()
        self._scene.clear()

    def close(self) -> None:
        """Stop the server."""
        super().close()
        self._server.stop()

    def _keep(self, msg_type: type, topic: str, profile: Any) -> None:
        """Subscribe; the newest message waits to be drawn."""

        def keep(msg: Any) -> None:
            self._newest[topic] = msg
            if topic == POINTS:
                self._clouds.append(msg)
            elif topic == ODOMETRY:
                self._scene.watch(msg)

        self.create_subscription(msg_type, topic, keep, profile)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self._scene.add_report(report)
                self._newest[TOPIC] = msg

    def _draw(self) -> None:
        if not self._server.get_clients():  # messages wait for a client
            return
        newest, self._newest = self._newest, {}
        self._posed |= ODOMETRY in newest
        for topic, msg in newest.items():
            if topic == POINTS and self._posed:
                continue  # clouds are drawn with their poses
            try:
                with self.timer.stage(topic.strip('/')):
                    self._draw_one(topic, msg)
            except MalformedMessage as error:
                self.diagnostics.rejected['malformed'] += 1
                self.get_logger().warning(f'message on {topic} not shown: {error}', throttle_duration_sec=5.0)
        self.diagnostics.counts['drawn'] += bool(newest)

    def _draw_one(self, topic: str, msg: Any) -> None:
        if topic == TOPIC:
            self._scene.diagnostics()
        elif topic == ODOMETRY:
            self._scene.odometry(msg, tuple(self._clouds))
        else:
            getattr(self._scene, topic)(msg)


def _normals(msg: PointCloud2) -> Any:
    """Normals (n, 3) of a cloud of n points."""
    columns = [v.astype(np.float32).reshape(-1) for v in read_fields(msg, _NORMALS).values()]
    if any(len(c) != msg.height * msg.width for c in columns):
        raise MalformedMessage('the cloud has normals that are not one number per point')
    return np.stack(columns, axis=1)


def _known(frame: str) -> str:
    """One of the target frames; others are refused, as the scene keeps every frame for ever."""
    if frame not in FRAMES:
        raise MalformedMessage(f'{frame!r} is no target frame: {" or ".join(FRAMES)}')
    return frame


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner viewer``."""
    return run(ViewerNode, args)


if __name__ == '__main__':
    sys.exit(main())
