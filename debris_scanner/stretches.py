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

"""Does each stretch of a scan hold against a model of the others?

A model explains the stretch that it was made from, rightly posed or not: only the others can tell. This
settles what a single frame leaves open, for a round flank comes to rest beside its place however right its
pose.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.cost_scan import turn_costs, weakest_axis
from debris_scanner.evidence import POINTS, drawn_evenly, drawn_views, settled
from debris_scanner.frames import TargetFrame
from debris_scanner.fusion import FusedSurface, FusionSettings
from debris_scanner.geometry import Array, compose, inverse, rotation_angle
from debris_scanner.refinement import fuse
from debris_scanner.views import Surface

APART_NS = 1_000_000_000  # between two stretches the target was out of sight,
APART = 5.0  # and for longer, by this, than between two frames: a slow target has few key frames
PARTS = 3  # of a scan without gaps
FUSED = 80  # frames of the others, drawn evenly
ASKED = 8  # frames of a stretch, and for the axis
TURNS_DEG = tuple(turn for turn in range(-180, 180, 10) if turn)


@dataclass(frozen=True)
class StretchEvidence:
    """What a model of the others says of a stretch."""

    turn: float  # rad, by which it turns the frames that are registered to it (median)
    least_cost: float  # of turning it by 10 to 180 degrees about the weakest axis, relative to none


UNKNOWN = StretchEvidence(np.pi, 0.0)


def stretch_evidence(
    fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]], settings: FusionSettings
) -> Iterator[StretchEvidence]:
    """What the others say of each stretch of posed frames (T_target_sensor).

    They turn, or match, at random what they never saw: such a stretch does not hold.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    axis, point = weakest_axis(surface, drawn_views(frames, range(len(frames)), ASKED))
    for stretch in _stretches([frame.stamp_ns for frame, _ in frames]):
        rest = np.setdiff1d(np.arange(len(frames)), stretch)
        others = fuse([frames[rest[n]] for n in drawn_evenly(len(rest), FUSED)], settings)
        if others is None:
            yield UNKNOWN
            continue
        surface = Surface.sampled(others.vertices, others.normals, POINTS)
        asked = drawn_views(frames, stretch, ASKED)
        moves = [compose(settled(surface, view, T), inverse(T)) for view, T in asked]
        turn = float(np.median([rotation_angle(move[:3, :3]) for move in moves]))
        yield StretchEvidence(turn, min(turn_costs(surface, asked, axis, point, TURNS_DEG)))


def _stretches(stamps_ns: Sequence[int]) -> list[list[int]]:
    """Indices of the frames of each stretch in sight, or of each third of a scan that has but one."""
    order = np.argsort(stamps_ns, kind='stable')
    apart = np.diff(np.asarray(stamps_ns)[order])
    gaps = np.flatnonzero(apart > max(APART_NS, APART * float(np.median(apart)))) + 1
    parts = np.split(order, gaps) if len(gaps) else np.array_split(order, PARTS)
    return [part.tolist() for part in parts if len(part)]
