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

"""Messages as drivers and our own nodes send them, damaged, and what reads them.

A case draws all it does from one source of randomness, so a number names it for ever.
"""

import copy
from array import array
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mutations import damaged, disturb
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, FrameRejected, Model
from debris_scanner.nodes.lifecycle.diagnostics import HARDWARE_ID, key_values, read_reports
from debris_scanner.nodes.publishing.closure_publisher import read_candidates
from debris_scanner.nodes.publishing.estimates import read_status
from debris_scanner.sensing.depth_offset import DepthOffset
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.settings import Settings
from debris_scanner.stages import make_preprocessor
from msg_adapters.clouds import cloud_message
from msg_adapters.colour_images import colour_image_message, read_colour
from msg_adapters.depth_images import (
    camera_info_message,
    cloud_frame_message,
    depth_image_message,
)
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.decoder import FrameDecoder
from msg_adapters.models import (
    depth_offset_message,
    mesh_marker,
    model_message,
    read_depth_offset,
    read_mesh,
    read_model,
)
from msg_adapters.poses import (
    ClosureTransform,
    closure_message,
    odometry_message,
    path_message,
    read_closure,
    read_odometry,
    read_path,
    read_target_pose,
    target_pose_message,
)
from msg_adapters.stamps import header_message
from msg_adapters.target_frames import read_target_frame, target_frame_message

CAMERA = Camera(52.5, 52.5, 31.5, 23.5, 64, 48)
S = 10**18
EYE4, EYE6 = np.eye(4), np.eye(6)
OFFSET = DepthOffset(0.05, (-3, 2), np.full((6, 5), 1e-3))

Read = Callable[..., Any]


@cache
def depth_frame() -> DepthFrame:
    """A sphere in the box, and a wall behind it."""
    v, u = np.mgrid[:48, :64]
    within = (u - 31.5) ** 2 + (v - 23.5) ** 2 < 15**2
    depth = np.where(within, 0.6 + 1e-4 * ((u - 31.5) ** 2 + (v - 23.5) ** 2), 2.0).astype(np.float32)
    colour = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    return DepthFrame(S, depth, CAMERA, colour)


def diagnostics(values: dict[str, Any], name: str) -> DiagnosticArray:
    status = DiagnosticStatus(name=name, hardware_id=HARDWARE_ID, message='m', values=key_values(values))
    return DiagnosticArray(header=header_message(S, ''), status=[status])


def model() -> Model:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (60, 3)).astype(np.float32)
    triangles = np.arange(60, dtype=np.int32).reshape(20, 3)
    return Model(points, points, points, triangles, rng.integers(0, 256, (60, 3), dtype=np.uint8))


@cache
def seeds() -> dict[str, tuple[list[Any], Read]]:
    """Whole messages of each kind, those that are read together, and what reads them."""
    frame = depth_frame()
    box = IsolationSettings(box_min=(-0.4, -0.4, 0.3), box_max=(0.4, 0.4, 1.2))
    target = make_preprocessor(replace(Settings(), isolation=box)).process(frame)
    points = cloud_frame_message(frame, 'sensor')
    doubles = cloud_message(S, 's', {a: np.linspace(0.3, 1, 200) for a in 'zxy'})
    big_endian = copy.deepcopy(points)
    big_endian.is_bigendian = True
    image, metres = (depth_image_message(S, 's', frame.depth, e) for e in ('16UC1', '32FC1'))
    info = camera_info_message(S, 's', CAMERA)
    status = {
        'scan_ns': S,
        'state': 'scanning',
        'accepted': 1,
        'keyframe': 1,
        'tracked': 0,
        'path_rad': 1,
        'usable_for_mapping': 1,
        'submap': 0,
    }
    candidate = {
        'from_stamp_ns': S,
        'to_stamp_ns': S + 1,
        'probability': 0.5,
        'accepted': 1,
        'T_from_to': '0.1 0.2 0.3 0 0 0 1',
    }
    report = {
        'stage': 'odometry',
        'count.used': 1,
        'rejected.x': 2,
        'timing.a.count': 1,
        'timing.a.p50_ms': 0.5,
    }
    return {
        'cloud': ([points], read_points),
        'cloud_unordered': ([doubles], read_points),
        'cloud_big_endian': ([big_endian], read_points),
        'depth_16UC1': ([image, info], read_image),
        'depth_32FC1': ([metres, info], read_image),
        'colour': ([colour_image_message(S, 's', frame.rgb)], read_colour),
        'target': ([target_frame_message(target, 's')], read_target_frame),
        'model': ([model_message(model(), S, 't'), mesh_marker(model(), S, 't')], read_model),
        'mesh': ([mesh_marker(model(), S, 't')], read_mesh),
        'pose': ([target_pose_message(S, 's', EYE4, EYE6)], read_target_pose),
        'odometry': ([odometry_message(S, 's', 't', EYE4, EYE6, np.zeros(6), EYE6)], read_odometry),
        'path': ([path_message(S, 't', [(S + i, EYE4) for i in range(3)])], read_path),
        'offset': ([depth_offset_message(OFFSET, S, 't')], read_depth_offset),
        'closure': ([closure_message(ClosureTransform(S, S + 1, EYE4))], read_closure_back),
        'status': ([diagnostics(status, 'odometry')], read_status_back),
        'candidates': ([diagnostics(candidate, 'closure')], read_candidates_back),
        'report': ([diagnostics(report, 'n')], lambda m: list(read_reports(m))),
    }


def read_points(message: Any) -> None:
    look_for_target(FrameDecoder().cloud(message))


def read_image(image: Any, info: Any) -> None:
    look_for_target(FrameDecoder().image(image, info))


def look_for_target(frame: DepthFrame) -> None:
    """What the node does with a frame: the first stage, and its message out and in again."""
    assert frame.depth.shape == (frame.camera.height, frame.camera.width)
    assert np.isfinite(frame.depth).all()
    target = make_preprocessor(Settings()).process(frame)
    assert np.isfinite(target.normals).all()
    read_target_frame(target_frame_message(target, 'sensor'))


def read_closure_back(message: Any) -> None:
    """A closure that is read can be said again: its stamps fit a message."""
    closure_message(read_closure(message))


def read_status_back(message: Any) -> None:
    status = read_status(message)
    header_message(status.stamp_ns, '')
    assert abs(status.path_rad) < 1e9 and abs(status.scan_ns) < 2**63


def read_candidates_back(message: Any) -> None:
    for record in read_candidates(message):
        assert 0 <= record.probability <= 1
        assert record.T_from_to is None or np.isfinite(record.T_from_to).all()
        assert max(abs(record.from_stamp_ns), abs(record.to_stamp_ns)) < 2**63


def attempt(read: Read, messages: list[Any]) -> None:
    """Read; a message may be refused in one line, or its frame."""
    try:
        with np.errstate(all='ignore'):
            read(*messages)
    except MalformedMessage as error:
        assert len(str(error)) < 2010
        assert '\n' not in str(error)
    except FrameRejected:
        pass


def run_fields(random: Random) -> None:
    """Fields that hold what their types allow."""
    messages, read = random.choice(list(seeds().values()))
    messages = copy.deepcopy(messages)
    disturb(random.choice(messages), random)
    attempt(read, messages)


def run_bytes(random: Random) -> None:
    """Bytes changed on the way: first the middleware's own parser has to bear them, then the readers."""
    messages, read = random.choice(list(seeds().values()))
    at = random.randrange(len(messages))
    parse(damaged(serialize_message(messages[at]), random), at, messages, read)


@cache
def types() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


def parse(raw: bytes, at: int, messages: list[Any], read: Read) -> None:
    """Serialised bytes in place of one of the messages, by rclpy's parser and by that of bags."""
    kind = type(messages[at])
    name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
    for decode in (lambda: deserialize_message(raw, kind), lambda: types().deserialize_cdr(raw, name)):
        try:
            message = decode()
        except MemoryError:
            raise
        except Exception:  # either parser has errors of its own
            continue
        if hasattr(message, 'data') and isinstance(message.data, array):
            assert len(message.data) <= len(raw)
        attempt(read, [*messages[:at], message, *messages[at + 1 :]])
