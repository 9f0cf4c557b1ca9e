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

"""Messages of the scan drawn into the scene that a browser shows."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.nodes.diagnostics import OK, Report
from debris_scanner.nodes.estimates import SCANNING_FRAME, TARGET_FRAME
from debris_scanner.viewer.drawing import by_direction, lit, thinned
from debris_scanner.viewer.scene import ScanScene
from msg_adapters.clouds import field_names, read_cloud, read_fields
from msg_adapters.errors import MalformedMessage
from msg_adapters.markers import read_graph
from msg_adapters.models import read_mesh
from msg_adapters.poses import read_odometry
from msg_adapters.stamps import read_stamp

FRAMES = (SCANNING_FRAME, TARGET_FRAME)
MOST_TRIANGLES = 200_000
_MOST_TEXT = 1000  # characters of a reading
_FORGOTTEN_S = 5.0  # a node that says nothing for so long is gone
_INPUTS = ('preprocess', 'scanner')
_NORMALS = ('normal_x', 'normal_y', 'normal_z')


class SceneMessages:
    """Draws one message at a time; what contradicts itself raises MalformedMessage and changes nothing.

    Args:
        scene: to draw into.
        max_points: gives the points of a cloud that are drawn at most.
    """

    def __init__(self, scene: ScanScene, max_points: Callable[[], int]) -> None:
        self._scene = scene
        self._max_points = max_points
        self._reports: dict[str, tuple[Report, float]] = {}

    def clear(self) -> None:
        """A new scan."""
        self._reports.clear()
        self._scene.clear()

    def odometry(self, msg: Odometry, clouds: Sequence[PointCloud2]) -> None:
        """The pose, with the cloud of the same stamp, else the last of those given."""
        pose = read_odometry(msg)
        frame = _known(pose.child_frame_id)
        if clouds:
            same = (c for c in clouds if read_stamp(c.header.stamp) == pose.stamp_ns)
            self.target_points(next(same, clouds[-1]))
        self._scene.show_pose(frame, pose.T_sensor_target)
        rate = np.rad2deg(np.linalg.norm(pose.twist[:3]))
        distance = np.linalg.norm(pose.T_sensor_target[:3, 3])
        self._scene.show_readings({'Turning': f'{rate:.1f} °/s', 'Distance': f'{distance:.3f} m'})

    def target_points(self, msg: PointCloud2) -> None:
        """The target as it is seen now, in its own colours or lit from the sensor."""
        cloud = read_cloud(msg)
        points, normals = cloud.xyz.reshape(-1, 3), _normals(msg)
        seen = np.flatnonzero(np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1))
        seen = seen[thinned(len(seen), self._max_points())]
        colours = lit(points[seen], normals[seen]) if cloud.rgb is None else cloud.rgb.reshape(-1, 3)[seen]
        self._scene.show_target(points[seen], colours)

    def graph_markers(self, msg: MarkerArray) -> None:
        """Key frames, and the lines between them."""
        frame, nodes, edges, closures = read_graph(msg)
        self._scene.show_graph(_known(frame), nodes, edges, closures)
        self._scene.show_readings({'Key frames': str(len(nodes)), 'Loop edges': str(len(closures))})

    def model(self, msg: PointCloud2) -> None:
        """The model's cloud; an empty one takes the last back."""
        frame, cloud = _known(msg.header.frame_id), read_cloud(msg)
        points = cloud.xyz.reshape(-1, 3)
        if not np.isfinite(points).all():
            raise MalformedMessage('model has points that are not finite')
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
        """The model's mesh; an empty one takes the last back."""
        frame = _known(msg.header.frame_id)
        if len(msg.points) > 3 * MOST_TRIANGLES:
            raise MalformedMessage(f'mesh of {len(msg.points) // 3} triangles: {MOST_TRIANGLES} at most')
        vertices, triangles = (None, None) if msg.action == Marker.DELETEALL else read_mesh(msg)
        if vertices is None or triangles is None:
            vertices, triangles = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
        self._scene.show_mesh(frame, vertices, triangles)

    def state(self, msg: String) -> None:
        """What the scan does."""
        self._scene.show_readings({'State': msg.data[:_MOST_TEXT]})

    def note(self, report: Report) -> None:
        """What a node says of itself, for :meth:`diagnostics` to show."""
        self._reports[report.stage] = report, time.monotonic()

    def diagnostics(self) -> None:
        """Frames, and what is amiss."""
        since = time.monotonic() - _FORGOTTEN_S
        self._reports = {stage: (r, at) for stage, (r, at) in self._reports.items() if at > since}
        reports = [report for report, _ in self._reports.values()]
        received = [r.counts.get('received', 0) for r in reports if r.stage in _INPUTS]
        rates = [r.values['frames_per_second'] for r in reports if 'frames_per_second' in r.values]
        if received:
            self._scene.show_readings(
                {'Frames': f'{received[0]}, {rates[0]} a second' if rates else f'{received[0]}'}
            )
        amiss = '\n'.join(f'{r.stage}: {r.message}' for r in reports if r.level != OK)
        self._scene.show_readings({'Remark': amiss[:_MOST_TEXT]})


def _normals(msg: PointCloud2) -> Any:
    """Normals (n, 3) of a cloud, n its points."""
    columns = [v.astype(np.float32).reshape(-1) for v in read_fields(msg, _NORMALS).values()]
    if any(len(c) != msg.height * msg.width for c in columns):
        raise MalformedMessage('cloud has normals that are not one number a point')
    return np.stack(columns, axis=1)


def _known(frame: str) -> str:
    """One of the target frames; others would be kept for ever."""
    if frame not in FRAMES:
        raise MalformedMessage(f'{frame!r} is no target frame: {" or ".join(FRAMES)}')
    return frame
