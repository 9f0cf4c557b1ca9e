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

"""Follows a scan and shows it: decides what the page says and draws, for live and offline scans alike.

Facts come in as they happen, also while nobody is watching, and cost next to nothing; :meth:`refresh` draws.
"""

import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.core.turn import TurnWatch, turn_words
from debris_scanner.viewer.drawing import (
    SEEN_COLOUR,
    Colours,
    Points,
    SeenCloud,
    borders_reached,
    depth_picture,
    lit,
    thinned,
)
from debris_scanner.viewer.guidance import LOST, SCANNING, Situation, guide
from debris_scanner.viewer.scene import ScanScene

SCANNING_FRAME, TARGET_FRAME = 'target_scanning', 'target'
FRAMES = (SCANNING_FRAME, TARGET_FRAME)  # target frames: before a model, and of the model
_A_KEY_FRAME = 3000  # points of a key frame that are kept of what was seen
_RECENT = 50  # poses, and key frames that wait for theirs
_STILL_S = 2.0  # without a pose for so long, the model is shown where the last frames had the target


@dataclass(frozen=True)
class Placed:
    """A pose of the target: T_sensor_target (4, 4) in the target frame of that name."""

    frame: str
    T_sensor_target: Array


class ScanPresenter:
    """Shows one scan after the other in a scene."""

    def __init__(self, scene: ScanScene) -> None:
        self.scene = scene
        self._begin()

    def _begin(self) -> None:
        self._now = Situation()
        self._turn = TurnWatch()
        self._poses: OrderedDict[int, Placed] = OrderedDict()
        self._waiting: OrderedDict[int, tuple[Points, Points]] = OrderedDict()
        self._scan_poses: dict[int, Array] = {}  # T_sensor_target of the key frames, before a model
        self._model_poses: Sequence[tuple[int, Array]] = ()  # T_target_sensor, in the model's frame
        self._seen = SeenCloud()
        self._seen_changed = False
        self._last: Placed | None = None
        self._moved_s = time.monotonic()
        self._shown_frame = ''

    def clear(self) -> None:
        """Start a new scan."""
        self._begin()
        self.scene.clear()

    @property
    def situation(self) -> Situation:
        """What is known of the scan now."""
        return self._now

    def know(self, **facts: Any) -> None:
        """Replace fields of the situation."""
        state = facts.get('state', self._now.state)
        if self._now.state == LOST and state == SCANNING:  # another submap: its poses fit no earlier ones
            self._seen, self._seen_changed = SeenCloud(), True
        self._now = replace(self._now, **facts)

    def follow(self, stamp_ns: int, frame: str, T_sensor_target: Array) -> None:
        """The estimate of a frame."""
        if self._now.state != LOST:  # then the pose is a guess
            self._turn.add(frame, T_sensor_target[:3, :3])
        self._last, self._moved_s = Placed(frame, T_sensor_target), time.monotonic()
        self._poses[stamp_ns] = self._last
        if stamp_ns in self._waiting:
            self._place(stamp_ns, *self._waiting.pop(stamp_ns))
        while len(self._poses) > _RECENT:
            self._poses.popitem(last=False)

    def add_keyframe(self, stamp_ns: int, points: Points, normals: Points) -> None:
        """A key frame's points (n, 3) and normals, sensor frame; before or after its pose."""
        some = thinned(len(points), _A_KEY_FRAME)
        if stamp_ns in self._poses:
            self._place(stamp_ns, points[some], normals[some])
            return
        self._waiting[stamp_ns] = points[some], normals[some]
        while len(self._waiting) > _RECENT:
            self._waiting.popitem(last=False)

    def _place(self, stamp_ns: int, points: Points, normals: Points) -> None:
        placed = self._poses[stamp_ns]
        if placed.frame != SCANNING_FRAME:
            return
        self._scan_poses[stamp_ns] = placed.T_sensor_target
        T = inverse(placed.T_sensor_target)
        moved = (points @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
        self._seen.add(moved, lit(points, normals, SEEN_COLOUR))
        self._seen_changed = True

    def place_model(self, poses: Sequence[tuple[int, Array]]) -> None:
        """Stamps and T_target_sensor (4, 4) of the key frames that the model was made from."""
        self._model_poses = poses

    def show_window(self, frame: TargetFrame, image: Camera | None) -> None:
        """The target's depth where it is in the image; without the image's camera, the window alone."""
        h, w = frame.depth.shape
        shape, corner = (h, w), (0, 0)
        if image is not None:
            shape = (image.height, image.width)
            corner = round(image.cy - frame.camera.cy), round(image.cx - frame.camera.cx)
        seen = frame.depth[frame.depth > 0]
        if not len(seen):
            return
        near, far = np.percentile(seen, (2, 98))
        said = f'depth of the target in the image: {near:.2f} to {far:.2f} m, near is bright'
        self.scene.panel.show_depth(depth_picture(frame.depth, corner, shape), said)
        cut = borders_reached(frame.depth, corner, shape) if image is not None else frozenset()
        self.know(cut=cut)

    def show_pose(self, placed: Placed, rate_deg: float) -> None:
        """Move the target; its rate in degrees a second."""
        self._shown_frame = placed.frame
        self.scene.show_pose(placed.frame, placed.T_sensor_target)
        self.scene.show_readings(
            {
                'Turning': f'{rate_deg:.1f} °/s',
                'Turn': turn_words(self._turn.shown),
                'Distance': f'{np.linalg.norm(placed.T_sensor_target[:3, 3]):.3f} m',
            }
        )

    def show_model_text(self, points: int, triangles: int | None = None) -> None:
        """Size of the model; no points: there is none."""
        more = '' if triangles is None else f', {triangles} triangles'
        self.scene.show_readings({'Model': f'{points} points{more}' if points else 'none yet'})

    def refresh(self) -> None:
        """Draw what has changed apart from clouds and poses: the guide, what was seen, a model at rest."""
        self.know(turned=self._turn.shown)
        self.scene.panel.show_guide(guide(self._now))
        if self._seen_changed:
            self._seen_changed = False
            self._draw_seen()
        resting = time.monotonic() - self._moved_s > _STILL_S or self._now.result is not None
        if resting and self._shown_frame != TARGET_FRAME and (T := self._resting_pose()) is not None:
            self._shown_frame = TARGET_FRAME
            self.scene.show_pose(TARGET_FRAME, T)

    def _draw_seen(self) -> None:
        self.scene.show_seen(SCANNING_FRAME, self._seen.points, self._seen.colours)

    def _resting_pose(self) -> Array | None:
        """T_sensor_target of the last frame in the model's frame, which no estimate has used yet."""
        if not self._model_poses or self._last is None:
            return None
        if self._last.frame == TARGET_FRAME:
            return self._last.T_sensor_target
        for stamp_ns, T_target_sensor in reversed(self._model_poses):
            if stamp_ns in self._scan_poses:
                T_sensor_scan = self._scan_poses[stamp_ns]
                since = compose(self._last.T_sensor_target, inverse(T_sensor_scan))
                return compose(since, inverse(T_target_sensor))
        return inverse(self._model_poses[-1][1])

    def conclude(
        self,
        result: Mapping[str, Any],
        rows: Sequence[tuple[str, str]],
        links: Iterable[tuple[str, str]],
    ) -> None:
        """The scan has ended: its summary, the rows of its table, and addresses with names."""
        self.know(result=result)
        self.scene.show_readings(dict.fromkeys(('Turning', 'Turn', 'Distance', 'Remark'), ''))
        told = dict(rows)
        shown = {'Frames': 'frames', 'Key frames': 'key frames', 'Loop edges': 'closures', 'Model': 'model'}
        self.scene.show_readings({name: '' for name, row in shown.items() if row in told})
        if self._model_poses:  # what the sensor saw last would hide it
            self.scene.show_target(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
        self.scene.panel.show_end(rows, list(links))
        self.refresh()


def cloud_of(frame: TargetFrame) -> tuple[Points, Points, Colours | None]:
    """Points (n, 3), normals (n, 3) and, if the frame has them, colours of a target frame."""
    seen = frame.depth > 0
    points = frame.camera.back_project(frame.depth)[seen]
    return points, frame.normals[seen], None if frame.rgb is None else frame.rgb[seen]
