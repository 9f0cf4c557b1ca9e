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

"""How much worse frames fit a model that is turned about the axis of which they tell least.

The information at the pose says how sharp the minimum is there; only a scan says whether it is the one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.evidence import GATE, POINTS, drawn_views, misfit
from debris_scanner.frames import TargetFrame
from debris_scanner.fusion import FusedSurface
from debris_scanner.geometry import Array, compose, exp_so3, inverse, transform
from debris_scanner.observability import marginal_rotation
from debris_scanner.registration import linearise
from debris_scanner.views import Surface, View

FRAMES = 12  # that are asked, drawn evenly
TURNS_DEG = (-30, -20, -10, 10, 20, 30)


@dataclass(frozen=True)
class CostScan:
    """Mean cost of the frames as posed and turned about the weakest axis, relative to the former."""

    axis: Array  # (3,), unit, target frame
    turns_deg: tuple[int, ...]
    costs: tuple[float, ...]  # 1 where the turn can't be seen at all

    @property
    def least(self) -> float:
        """Of all turns."""
        return min(self.costs)


def scan_weakest_axis(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> CostScan:
    """Turn posed frames (T_target_sensor) about the model's weakest axis, and see what it costs.

    The cost of a point of the model in view is its squared distance, at most the gate's.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    asked = drawn_views(frames, range(len(frames)), FRAMES)
    axis, point = weakest_axis(surface, asked)
    return CostScan(axis, TURNS_DEG, turn_costs(surface, asked, axis, point, TURNS_DEG))


def weakest_axis(surface: Surface, asked: Sequence[tuple[View, Array]]) -> tuple[Array, Array]:
    """Axis (3,) of least rotation information, translation marginalised, and a point (3,) on it.

    The point matters: turned beside its axis a cylinder moves sideways, which is seen.
    """
    centre = surface.points.mean(axis=0).astype(np.float64)
    H = sum((linearise(surface, np.eye(4), view, T, GATE).H for view, T in asked), np.zeros((6, 6)))
    rotation, shift = marginal_rotation(H, centre)
    axis = np.linalg.eigh(rotation)[1][:, 0]
    return axis, centre + np.cross(axis, shift @ axis)


def turn_costs(
    surface: Surface,
    asked: Sequence[tuple[View, Array]],
    axis: Array,
    point: Array,
    turns_deg: Sequence[float],
) -> tuple[float, ...]:
    """Mean cost of posed views (T_target_view) once the surface is turned, relative to that as posed."""
    turns = [exp_so3(np.radians(turn) * axis) for turn in turns_deg]
    about = [transform(R, point - R @ point) for R in turns]
    here = _cost(surface, asked, np.eye(4))
    return tuple(_cost(surface, asked, T) / here for T in about)


def _cost(surface: Surface, asked: Sequence[tuple[View, Array]], T_turned: Array) -> float:
    T_back = inverse(T_turned)
    turned = ((view, compose(T_back, T)) for view, T in asked)
    return float(np.mean([misfit(linearise(surface, np.eye(4), v, T, GATE).agreement) for v, T in turned]))
