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

"""What is around the target, in the frame of the sensor at rest: still objects, and a hand that turns it."""

from collections.abc import Callable

import numpy as np

from debris_scanner.core.geometry import Array, apply, inverse
from debris_scanner.core.parameters import did_you_mean
from debris_scanner.sim.shapes import Solid, box, join, lathe, place
from debris_scanner.sim.targets import Target

# relative to the target's extent
THICKNESS = 0.05  # of a desk
PLATE_RADIUS, PLATE_HEIGHT = 0.6, 0.08  # of a turntable
PALM, ARM_RADIUS, ARM_LENGTH = (0.3, 0.1, 0.35), 0.12, 2.5
GRIP = 0.3  # of the palm's middle from the axis
CLEAR = 0.75  # from the axis to a hand at the edge of the image, at least
AT_EDGE = 0.8  # of the way to that edge


def _wall() -> Solid:
    return box((3.0, 2.4, 0.05), (0.0, 0.0, 1.18))


def _table() -> Solid:
    """Table top below the target: its front edge runs across the image."""
    return box((1.6, 0.04, 0.8), (0.0, 0.33, 0.95))


def _object() -> Solid:
    """A mug-sized thing beside the target."""
    mug = lathe([(0.0, -0.05), (0.04, -0.05), (0.04, 0.05), (0.0, 0.05)], 32)
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return join([place(mug, (0.31, 0.15, 0.9), upright), box((0.03, 0.05, 0.015), (0.27, 0.15, 0.9))])


_BUILDERS: dict[str, Callable[[], Solid]] = {'wall': _wall, 'table': _table, 'object': _object}
HAND = 'hand'
DESK, PLATE = 'desk', 'plate'  # what the target stands on: it depends on the target
STOOD_ON = (DESK, PLATE)
CLUTTER_NAMES = tuple(_BUILDERS)


def make_desk(vertices: Array, axis: Array) -> Target:
    """Mesh of a desk that a turning target stands on.

    Args:
        vertices: of the target (n, 3), sensor frame, metres.
        axis: of its turn (3,), unit; the desk is square to it, on the lower side in the image.
    """
    foot, R, extent = _foot(vertices, axis)
    top = box((8 * extent, THICKNESS * extent, 5 * extent))
    corners, triangles = place(top, tuple(foot + THICKNESS / 2 * extent * R[:, 1]), R)
    return Target(DESK, corners.astype(np.float32), triangles)


def on_plate(target: Target, T_sensor_target: Array, axis: Array) -> Target:
    """The target with the plate of a turntable below it, which turns with it.

    Args:
        target: in its own frame.
        T_sensor_target: its pose (4, 4) at some time.
        axis: of its turn (3,), unit, sensor frame.
    """
    foot, R, extent = _foot(apply(T_sensor_target, target.vertices.astype(float)), axis)
    radius, height = PLATE_RADIUS * extent, PLATE_HEIGHT * extent
    disc = lathe([(0.0, 0.0), (radius, 0.0), (radius, height), (0.0, height)], 96)
    corners, triangles = place(disc, tuple(foot), np.column_stack([R[:, 0], -R[:, 2], R[:, 1]]))
    body = target.vertices.astype(float), target.triangles
    vertices, joined = join([body, (apply(inverse(T_sensor_target), corners), triangles)])
    return Target(target.name, vertices.astype(np.float32), joined)


def make_hand(vertices: Array, axis: Array) -> tuple[Target, Array]:
    """Mesh of a forearm with its hand on the target, and the way (3,) on which it leaves.

    Args:
        vertices: of the target (n, 3), sensor frame, metres.
        axis: of its turn (3,), unit; the arm comes from the right, square to it.
    """
    _, R, extent = _foot(vertices, axis)
    palm = box(PALM, (GRIP, 0.0, 0.0))
    arm = lathe([(0.0, 0.0), (ARM_RADIUS, 0.0), (ARM_RADIUS, ARM_LENGTH), (0.0, ARM_LENGTH)], 32)
    along_x = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    body, triangles = join([palm, place(arm, (GRIP + PALM[0] / 2, 0.0, 0.0), along_x)])
    corners = vertices.mean(axis=0) + extent * body @ R.T
    return Target(HAND, corners.astype(np.float32), triangles), R[:, 0] * ARM_LENGTH * extent


def hand_at_edge(vertices: Array, edge_m: float) -> Target:
    """Mesh of a hand beside a target (n, 3), sensor frame, that reaches in where the image ends.

    Args:
        vertices: of the target (n, 3), sensor frame, metres.
        edge_m: distance of the image's right edge from its middle, where the target is.
    """
    hand, _ = make_hand(vertices, np.array([0.0, 1.0, 0.0]))
    extent = float(np.ptp(vertices, axis=0).max())
    aside = max(AT_EDGE * edge_m, CLEAR * extent) - (GRIP - PALM[0] / 2) * extent
    return Target(HAND, hand.vertices + np.array([aside, 0.0, 0.0], np.float32), hand.triangles)


def _foot(vertices: Array, axis: Array) -> tuple[Array, Array, float]:
    """Where a target stands (3,), axes across, down and along of what it stands on (3, 3), its extent."""
    down = axis if axis[1] >= 0 else -axis
    middle = vertices.mean(axis=0)
    extent = float(np.ptp(vertices, axis=0).max())
    across = np.cross(down, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    R = np.column_stack([across, down, np.cross(across, down)])
    return middle + down * (float((vertices @ down).max()) - float(middle @ down)), R, extent


def make_clutter(name: str, scale: float = 1.0) -> Target:
    """Mesh of the named clutter, metres; at scale 1 it suits a target at 0.8 m.

    Raises:
        ValueError: unknown name.
    """
    if name not in _BUILDERS:
        names = (*CLUTTER_NAMES, *STOOD_ON)
        raise ValueError(
            f'unknown clutter {name!r}: choose one of {", ".join(names)}{did_you_mean(name, names)}'
        )
    vertices, triangles = _BUILDERS[name]()
    return Target(name, (vertices * scale).astype(np.float32), triangles)
