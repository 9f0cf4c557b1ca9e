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

import json
import queue
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.parameters import ParameterError
from debris_scanner.io.outcome import outcome_rows
from debris_scanner.io.result_files import SUMMARY, newest_since, summaries
from debris_scanner.nodes.inputs.sensor_input import NO_FRAMES
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import OK, TOPIC, Report, read_reports, throughput
from debris_scanner.nodes.lifecycle.parameters import declare, declare_live
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import PAUSED_TOPIC, StageNode
from debris_scanner.viewer.drawing import by_direction, lit, thinned
from debris_scanner.viewer.guidance import FINISHED
from debris_scanner.viewer.panel import FINISH, GENERATE, PAUSE, RESET, RESUME, SAVE
from debris_scanner.viewer.presenter import FRAMES, Placed, ScanPresenter
from debris_scanner.viewer.scene import ScanScene
from debris_scanner.viewer.server import (
    LOOPBACK,
    PORT,
    ViewerError,
    is_loopback,
    open_server,
    result_links,
    url_of,
)
from msg_adapters.clouds import field_names, read_cloud, read_scalars
from msg_adapters.errors import MalformedMessage
from msg_adapters.markers import read_graph
from msg_adapters.models import read_mesh
from msg_adapters.poses import read_odometry, read_path
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import read_target_frame

ODOMETRY, POINTS, KEYFRAMES = 'odometry', 'target_points', 'keyframe_points'
MOST_TRIANGLES = 200_000
GHOST_AHEAD_NS = 10_000_000_000
SERVICES = {GENERATE: 'generate_model', SAVE: 'save_model', FINISH: 'finish', RESET: 'reset'}
_MOST_TEXT = 1000  # characters of a reading
_FORGOTTEN_S = 5.0  # a node without a report for so long is gone
_RECENT = 10  # clouds that wait for their pose
_INPUTS = ('preprocess', 'scanner')
_OWNERS = ('graph', 'scanner')
_RECORDINGS = ('play_bag', 'sim_kinect')  # sources that end
_NORMALS = ('normal_x', 'normal_y', 'normal_z')
_PRESSES_S = 0.1  # how often pressed buttons are looked for


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
        self.presenter = ScanPresenter(scene)

    def clear(self) -> None:
        """Start a new scan."""
        self._reports.clear()
        self.presenter.clear()

    def odometry(self, msg: Odometry, clouds: Sequence[PointCloud2]) -> None:
        """Draw the pose, with the cloud of the same stamp, else the latest of those given."""
        pose = read_odometry(msg)
        frame = _known(pose.child_frame_id)
        if clouds:
            same = (c for c in clouds if read_stamp(c.header.stamp) == pose.stamp_ns)
            self.target_points(next(same, clouds[-1]))
        rate = float(np.rad2deg(np.linalg.norm(pose.twist[:3])))
        self.presenter.show_pose(Placed(frame, pose.T_sensor_target), rate)

    def watch(self, msg: Odometry) -> None:
        """Follow the target; every message, as it goes on also while nobody is watching."""
        try:
            pose = read_odometry(msg)
            self.presenter.follow(pose.stamp_ns, _known(pose.child_frame_id), pose.T_sensor_target)
        except MalformedMessage:
            return  # counted when it is drawn

    def keyframe_points(self, msg: PointCloud2) -> None:
        """Keep what a key frame shows."""
        cloud, normals = read_cloud(msg), _normals(msg)
        points = cloud.xyz.reshape(-1, 3)
        valid = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
        self.presenter.add_keyframe(cloud.stamp_ns, points[valid], normals[valid])

    def keyframe_poses(self, msg: PathMessage) -> None:
        """Keep where the key frames are in the model's frame."""
        self.presenter.place_model(read_path(msg))

    def target_points(self, msg: PointCloud2) -> None:
        """Draw the target as it is seen now, in its own colours or lit from the sensor."""
        cloud = read_cloud(msg)
        points, normals = cloud.xyz.reshape(-1, 3), _normals(msg)
        valid = np.flatnonzero(np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1))
        valid = valid[thinned(len(valid), self._max_points())]
        colours = lit(points[valid], normals[valid]) if cloud.rgb is None else cloud.rgb.reshape(-1, 3)[valid]
        self._scene.show_target(points[valid], colours)
        try:
            self.presenter.show_window(read_target_frame(msg), self._image())
        except MalformedMessage:
            return  # too few pixels for a window

    def _image(self) -> Camera | None:
        """Size and centre of the sensor's image, as its stage reports them."""
        for stage in _INPUTS:
            if stage in self._reports:
                values = self._reports[stage][0].values
                try:
                    width, height = int(values['image.width']), int(values['image.height'])
                    cx, cy = float(values['image.cx']), float(values['image.cy'])
                except (KeyError, ValueError):
                    continue
                if 0 < width <= 4096 and 0 < height <= 4096 and np.isfinite([cx, cy]).all():
                    return Camera(1.0, 1.0, cx, cy, width, height)
        return None

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
        if self.presenter.situation.result is None:
            self.presenter.show_model_text(len(points))
        if len(points):
            self._scene.show_seen(FRAMES[0], points[:0], colours[:0])

    def model_mesh(self, msg: Marker) -> None:
        """Draw the model's mesh; an empty one clears it."""
        frame = _known(msg.header.frame_id)
        if len(msg.points) > 3 * MOST_TRIANGLES:
            raise MalformedMessage(f'mesh of {len(msg.points) // 3} triangles: {MOST_TRIANGLES} at most')
        vertices, triangles = (None, None) if msg.action == Marker.DELETEALL else read_mesh(msg)
        if vertices is None or triangles is None:
            vertices, triangles = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
        self._scene.show_mesh(frame, vertices, triangles)

    def forecast(self, msg: PathMessage) -> None:
        """Draw the model's ghost where it is expected in ten seconds."""
        ahead_ns = read_stamp(msg.header.stamp) + GHOST_AHEAD_NS
        later = (T for stamp_ns, T in read_path(msg) if stamp_ns >= ahead_ns)
        if (T_sensor_target := next(later, None)) is not None:
            self._scene.show_forecast(T_sensor_target)

    def state(self, msg: String) -> None:
        """Show the state of the scan."""
        self.presenter.know(state=msg.data[:_MOST_TEXT])

    def paused(self, msg: Bool) -> None:
        """Show whether frames are dropped."""
        self.presenter.know(paused=bool(msg.data))

    def add_report(self, report: Report) -> None:
        """Keep the report of a node, for :meth:`diagnostics` to show."""
        before = self._reports.get(report.stage)
        self._reports[report.stage] = report, time.monotonic()
        if report.stage in _INPUTS and before is not None:
            old = before[0]
            rejected = {r: n - old.rejected.get(r, 0) for r, n in report.rejected.items()}
            received = report.counts.get('received', 0) - old.counts.get('received', 0)
            self.presenter.know(rejected={r: n for r, n in rejected.items() if n > 0}, received=received)
        if report.stage in _RECORDINGS and report.values.get('finished') == '1':
            self.presenter.know(source_ended=True)
        if report.stage in _OWNERS:
            phase, ended = report.values.get('phase', ''), report.values.get('finished') == '1'
            self.presenter.know(phase=phase[:_MOST_TEXT])
            if ended and not phase:
                self.presenter.know(state=FINISHED)

    def diagnostics(self) -> None:
        """Show the number of frames, and warnings and errors."""
        now = self.presenter.situation
        if now.result is not None:  # its counts are final
            return
        since = time.monotonic() - _FORGOTTEN_S
        self._reports = {stage: (r, at) for stage, (r, at) in self._reports.items() if at > since}
        reports = [report for report, _ in self._reports.values()]
        received = [r.counts.get('received', 0) for r in reports if r.stage in _INPUTS]
        rates = [r.values['frames_per_second'] for r in reports if 'frames_per_second' in r.values]
        if received:
            self._scene.show_readings(
                {'Frames': f'{received[0]}, {rates[0]} a second' if rates else f'{received[0]}'}
            )
        # that a recording has ended is no fault of its input
        quiet = _INPUTS if now.source_ended else ()
        told = [r for r in reports if r.level != OK]
        told = [r for r in told if not (r.stage in quiet and r.message.startswith(NO_FRAMES))]
        warnings = '\n'.join(f'{r.stage}: {r.message}' for r in told)
        self._scene.show_readings({'Remark': warnings[:_MOST_TEXT]})

    def conclude(self, folder: Path, served: bool) -> None:
        """Show the result of the scan in a folder, whose files the page may serve.

        Raises:
            OSError, ValueError, KeyError, TypeError: it has no result that can be read.
        """
        summary = json.loads((folder / SUMMARY).read_text(encoding='utf-8'))
        self.presenter.conclude(summary, outcome_rows(summary), result_links(folder) if served else [])


class ViewerNode(StageNode):
    """Keeps the newest message of each topic; draws a few times a second while a client is connected."""

    def __init__(self) -> None:
        super().__init__('viewer')
        host = declare(self, 'host', LOOPBACK, 'address to serve on; 0.0.0.0 serves the whole network')
        port = declare(self, 'port', PORT, 'port to serve on; 0 takes a free one', 0, 65535)
        rate = declare(self, 'max_rate_hz', 5.0, 'most updates a second', 0.1, 30.0)
        owner = declare(self, 'owner', 'graph', 'node that owns the scan: graph or scanner')
        results = declare(self, 'result_dir', '', 'folder of the results, shown at the end; empty: none')
        self._results = Path(results) if results else None
        self._earlier = summaries(self._results) if self._results else {}
        points = declare_live(self, 'max_points', 20_000, 'most points drawn of a cloud', 100, 10**6)
        try:
            self._server = open_server(host, port, self._results)
        except ViewerError as error:
            raise ParameterError(str(error)) from None
        self._presses: queue.SimpleQueue[str] = queue.SimpleQueue()  # from the server's threads
        press = self._presses.put if is_loopback(host) else None  # who may look need not steer
        self._page = ScanScene(self._server, FRAMES, press)
        self._scene = SceneMessages(self._page, points)
        self._asked = {
            name: self.create_client(Trigger, f'{owner}/{service}') for name, service in SERVICES.items()
        }
        self._pause = self.create_client(SetBool, f'{owner}/pause')
        self.create_timer(_PRESSES_S, self._act)
        self.create_service(Trigger, '~/show_result', self._on_show_result)
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
        self._keep(PathMessage, 'forecast', qos.waiting())
        self._keep(PathMessage, 'keyframe_poses', qos.latched())
        self._keep(Bool, PAUSED_TOPIC, qos.latched())
        self.create_subscription(PointCloud2, KEYFRAMES, self._on_keyframe, qos.waiting())
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

    def _on_keyframe(self, msg: PointCloud2) -> None:
        try:
            self._scene.keyframe_points(msg)
        except MalformedMessage as error:
            self._complain(KEYFRAMES, error)

    def _act(self) -> None:
        """Call the services of the buttons that were pressed."""
        while not self._presses.empty():
            name = self._presses.get()
            client, request = self._asked.get(name), Trigger.Request()
            if name in (PAUSE, RESUME):
                client, request = self._pause, SetBool.Request(data=name == PAUSE)
            if client is None or not client.service_is_ready():
                self._page.panel.show_answer(f'{name}: no node of the scan answers')
                continue
            self._page.panel.show_answer(f'{name}: on its way')
            client.call_async(request).add_done_callback(lambda answer, name=name: self._tell(name, answer))

    def _tell(self, name: str, answer: Any) -> None:
        reply = answer.result()
        text = f'{name}: {reply.message}' if reply is not None else f'{name}: no answer'
        self._page.panel.show_answer(text[:_MOST_TEXT])

    def _on_show_result(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            if self._results is None:
                raise FileNotFoundError('no result_dir is given')
            self._draw_newest()
            written = newest_since(self._results, self._earlier)
            if written is None:
                raise FileNotFoundError(f'this scan is not saved in {self._results}')
            self._scene.conclude(written, written == self._results)
            response.success, response.message = True, 'shown'
        except (OSError, ValueError, KeyError, TypeError) as error:
            response.success, response.message = False, f'no result to show: {error}'
        return response

    def _complain(self, topic: str, error: MalformedMessage) -> None:
        self.diagnostics.rejected['malformed'] += 1
        self.get_logger().warning(f'message on {topic} not shown: {error}', throttle_duration_sec=5.0)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self._scene.add_report(report)
                self._newest[TOPIC] = msg

    def _draw(self) -> None:
        if not self._server.get_clients():  # messages wait for a client
            return
        self._draw_newest()
        self._scene.presenter.refresh()

    def _draw_newest(self) -> None:
        newest, self._newest = self._newest, {}
        self._posed |= ODOMETRY in newest
        for topic, msg in newest.items():
            if topic == POINTS and self._posed:
                continue  # clouds are drawn with their poses
            try:
                with self.timer.stage(topic.strip('/')):
                    self._draw_one(topic, msg)
            except MalformedMessage as error:
                self._complain(topic, error)
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
    columns = [v.astype(np.float32).reshape(-1) for v in read_scalars(msg, _NORMALS).values()]
    return np.stack(columns, axis=1)


def _known(frame: str) -> str:
    """One of the target frames, without prefix; others are refused: the scene keeps every frame for ever."""
    for name in FRAMES:
        if frame.endswith(name):
            return name
    raise MalformedMessage(f'{frame!r} is no target frame: {" or ".join(FRAMES)}')


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner viewer``."""
    return run(ViewerNode, args)


if __name__ == '__main__':
    sys.exit(main())
