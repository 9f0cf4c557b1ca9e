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

"""The estimated pose of every frame as the sensor sees it: a slider chooses the frame, the page draws it.

The page's script projects the model, or its axes alone, along the sensor's view; here is what it needs.
"""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, to_pose_vector
from debris_scanner.core.results import StampedPose
from debris_scanner.report.fragments import script_json
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import evenly

MOST_FRAMES = 2000
_ALONE = 0.15  # length of the axes without a model, in distances of the target
_MARGIN = 1.08  # about all that is drawn


def frame_view(scan: ScanOutput) -> str:
    """The figure as HTML; empty where fewer than two frames have a pose."""
    poses = scan.poses if len(scan.poses) > 1 else scan.odometry
    if len(poses) < 2:
        return ''
    content = frame_data(scan, poses)
    last = len(content['numbers']) - 1
    what = 'the axes of its frame' if scan.surface is None else 'its model and the axes of its frame'
    return (
        '<div class="plots"><figure class="wide"><h3>Frame by frame</h3>'
        f'<div class="slider"><label for="frame">Frame</label><input type="range" id="frame" '
        f'min="0" max="{last}" value="0"><output id="pose" for="frame"></output></div>'
        '<canvas id="frames" role="img" aria-label="the target at the chosen frame"></canvas>'
        f'<script type="application/json" data-for="frames">{script_json(content)}</script>'
        f"<figcaption>The target along the sensor's view, as estimated at the chosen frame: {what} (x, y, "
        'z). The small cross is the middle of the image. Arrow keys go from frame to frame. <b>Look for</b> '
        'steps: a target that turns evenly moves evenly.</figcaption></figure></div>'
    )


def frame_data(scan: ScanOutput, poses: list[StampedPose]) -> dict[str, Any]:
    """What the script draws, arrays as base64 of little-endian numbers.

    ``poses`` (n, 7) float32: x, y, z in metres and the quaternion, scalar last, of T_sensor_target;
    ``seconds`` (n,) float32; ``numbers`` counts the frames from 1; ``window`` is left, right, top and bottom
    of what the figure shows, in tangents of the angle from the optical axis; ``axes`` their length, metres.
    """
    shown = [int(k) for k in evenly(len(poses), MOST_FRAMES)]
    T = np.array([poses[k].T_sensor_target for k in shown])
    stamps = np.array([poses[k].stamp_ns for k in shown], dtype=np.int64)
    keys = set(scan.keyframes.stamps_ns.tolist())
    content: dict[str, Any] = {
        'poses': _packed(np.array([to_pose_vector(t) for t in T]), '<f4'),
        'seconds': _packed(scan.seconds(stamps), '<f4'),
        'numbers': [k + 1 for k in shown],
        'of': len(poses),
        'keys': [k for k, s in enumerate(stamps.tolist()) if s in keys],
    }
    if scan.surface is None:
        reach = _ALONE * float(np.median(np.linalg.norm(T[:, :3, 3], axis=1)))
    else:
        mesh = scan.surface.rough
        reach = float(np.linalg.norm(mesh.vertices, axis=1).max())
        content['vertices'] = _packed(mesh.vertices, '<f4')
        content['triangles'] = _packed(mesh.triangles, '<u4')
        content['observed'] = _packed(mesh.observed, 'u1')
    return content | {'axes': reach, 'window': window(T[:, :3, 3], reach)}


def window(centres: Array, reach: float) -> list[float]:
    """Left, right, top and bottom, as tangents, about balls of radius ``reach`` at centres (n, 3), metres."""
    depth = np.maximum(centres[:, 2], 1e-6)
    middle = centres[:, :2] / depth[:, None]
    half = _MARGIN * reach / depth[:, None]
    low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
    return [float(low[0]), float(high[0]), float(low[1]), float(high[1])]


def _packed(values: NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()
