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

"""What the frames say of a scan: could the rotation be seen, and does the model explain what was seen?

How much worse frames fit a model that is turned about the axis of which they tell least.

The information at the pose says how sharp the minimum is there; only a scan says whether it is the one.

Does each stretch of a scan hold against a model of the others?

A model explains the stretch that it was made from, rightly posed or not: only the others can tell. This
settles what a single frame leaves open, for a round flank comes to rest beside its place however right its
pose.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    exp_se3,
    exp_so3,
    inverse,
    rotation_angle,
    transform,
)
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.modelling.frame_store import StoredFrame
from debris_scanner.modelling.fusion import FusedSurface, FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.registration.projective import (
    RegistrationStats,
    linearise,
    marginal_rotation,
    rotation_observability,
    solve_step,
)
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View

FRAMES = 40  # that are asked, drawn evenly
POINTS = 3000  # of the model that each is asked about
GATE = 0.008  # m
MODEL_GATES = (0.02, 0.012, 0.012, 0.008, 0.008)  # m
OBSERVABILITY_GATE = 0.012  # m
MIN_MATCHES = 50


@dataclass(frozen=True)
class FrameEvidence:
    """How a frame agrees with the model, and how far it moves when it is registered to the model alone."""

    stats: RegistrationStats
    turn: float  # rad
    gain: float  # factor by which it fits the model better there: a round flank slides for nothing
    shift: float  # m, of the model's centre, where the frame holds it: a face says little of shifts along it


def rotation_evidence(
    stored: Sequence[StoredFrame], keyframes: KeyFrameSet, normals: NormalSettings
) -> list[float]:
    """Rotation information of some frames, each against the key frame nearest in time."""
    if not stored or not len(keyframes):
        return []
    poses = {k.stamp_ns: k.T_target_sensor for k in keyframes.frames}
    stamps = np.array([k.stamp_ns for k in keyframes.frames])
    values = []
    for n in subsample_indices(len(stored), FRAMES):
        item = stored[n]
        order = np.argsort(np.abs(stamps - item.stamp_ns))
        nearest = next((int(k) for k in order if stamps[k] != item.stamp_ns), None)
        if nearest is None:
            continue
        view, T = View(item.restore(normals)), item.pose(poses)
        T_reference = keyframes.frames[nearest].T_target_sensor
        lin = linearise(view, T, keyframes.views[nearest], T_reference, OBSERVABILITY_GATE)
        if lin.stats.matched > MIN_MATCHES:
            values.append(rotation_observability(lin.H, lin.stats.matched, view, T))
    return values


def model_evidence(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> list[FrameEvidence]:
    """What some of the posed frames (T_target_sensor) that a surface was made from say of it."""
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    centre = surface.points.mean(axis=0).astype(np.float64)
    evidence = []
    for n in subsample_indices(len(frames), FRAMES):
        view, T = View(frames[n][0]), frames[n][1]
        stats = linearise(surface, np.eye(4), view, T, GATE).stats
        T_settled = register_to_model(surface, view, T)
        move = compose(T_settled, inverse(T))
        there = linearise(surface, np.eye(4), view, T_settled, GATE)
        shift = _held_length(apply(move, centre) - centre, there.H[3:, 3:])
        gain = misfit(stats) / misfit(there.stats)
        evidence.append(FrameEvidence(stats, rotation_angle(move[:3, :3]), gain, shift))
    return evidence


def misfit(stats: RegistrationStats) -> float:
    """Mean square distance (m²) of the model in view from a frame, each point's at most the gate's."""
    a = stats
    return a.visible_inlier_ratio * min(a.rms, GATE) ** 2 + (1 - a.visible_inlier_ratio) * GATE**2


def _held_length(shift: Array, information: Array) -> float:
    """Length of a shift (3,), its parts weighted by their information (3, 3), the best known by 1."""
    best = max(float(np.linalg.eigvalsh(information)[-1]), 1e-12)
    return float(np.sqrt(max(0.0, float(shift @ information @ shift)) / best))


def register_to_model(surface: Surface, view: View, T_target_view: Array) -> Array:
    """Pose (4, 4) that a view comes to rest at when it is registered to the surface alone."""
    for gate in MODEL_GATES:
        lin = linearise(surface, np.eye(4), view, T_target_view, gate)
        # the twist moves the surface; the view moves the other way
        T_target_view = compose(exp_se3(-solve_step(lin.H, lin.g)), T_target_view)
    return T_target_view


def subsample_indices(count: int, most: int) -> list[int]:
    """Indices of so many out of a number, evenly spread."""
    return [int(n) for n in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))]


def subsample_views(
    frames: Sequence[tuple[TargetFrame, Array]], indices: Sequence[int], most: int
) -> list[tuple[View, Array]]:
    """Views and poses (T_target_view) of so many of the posed frames with these indices, evenly spread."""
    drawn = (frames[indices[n]] for n in subsample_indices(len(indices), most))
    return [(View(frame), T) for frame, T in drawn]


PROFILE_FRAMES = 12  # that are asked, drawn evenly
PROFILE_TURNS_DEG = (-30, -20, -10, 10, 20, 30)


@dataclass(frozen=True)
class RotationCostProfile:
    """Mean cost of the frames as posed and turned about the weakest axis, relative to the former."""

    axis: Array  # (3,), unit, target frame
    turns_deg: tuple[int, ...]
    costs: tuple[float, ...]  # 1 where the turn can't be seen at all

    @property
    def least(self) -> float:
        """Of all turns."""
        return min(self.costs)


def profile_weakest_axis(
    fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]
) -> RotationCostProfile:
    """Turn posed frames (T_target_sensor) about the model's weakest axis, and see what it costs.

    The cost of a point of the model in view is its squared distance, at most the gate's.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    asked = subsample_views(frames, range(len(frames)), PROFILE_FRAMES)
    axis, point = weakest_axis(surface, asked)
    return RotationCostProfile(
        axis, PROFILE_TURNS_DEG, rotation_cost_profile(surface, asked, axis, point, PROFILE_TURNS_DEG)
    )


def weakest_axis(surface: Surface, asked: Sequence[tuple[View, Array]]) -> tuple[Array, Array]:
    """Axis (3,) of least rotation information, translation marginalised, and a point (3,) on it.

    The point matters: turned beside its axis a cylinder moves sideways, which is seen.
    """
    centre = surface.points.mean(axis=0).astype(np.float64)
    H = sum((linearise(surface, np.eye(4), view, T, GATE).H for view, T in asked), np.zeros((6, 6)))
    rotation, shift = marginal_rotation(H, centre)
    axis = np.linalg.eigh(rotation)[1][:, 0]
    return axis, centre + np.cross(axis, shift @ axis)


def rotation_cost_profile(
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
    return float(np.mean([misfit(linearise(surface, np.eye(4), v, T, GATE).stats) for v, T in turned]))


APART_NS = 1_000_000_000  # between two stretches the target was out of sight,
APART = 5.0  # and for longer, by this, than between two frames: a slow target has few key frames
PARTS = 3  # of a scan without gaps
FUSED = 80  # frames of the others, drawn evenly
ASKED = 8  # frames of a stretch, and for the axis
SEGMENT_TURNS_DEG = tuple(turn for turn in range(-180, 180, 10) if turn)


@dataclass(frozen=True)
class SegmentEvidence:
    """What a model of the others says of a stretch."""

    turn: float  # rad, by which it turns the frames that are registered to it (median)
    least_cost: float  # of turning it by 10 to 180 degrees about the weakest axis, relative to none


UNKNOWN = SegmentEvidence(np.pi, 0.0)


def segment_evidence(
    fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]], settings: FusionSettings
) -> Iterator[SegmentEvidence]:
    """What the others say of each stretch of posed frames (T_target_sensor).

    They turn, or match, at random what they never saw: such a stretch does not hold.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    axis, point = weakest_axis(surface, subsample_views(frames, range(len(frames)), ASKED))
    for segment in _segments([frame.stamp_ns for frame, _ in frames]):
        rest = np.setdiff1d(np.arange(len(frames)), segment)
        others = fuse([frames[rest[n]] for n in subsample_indices(len(rest), FUSED)], settings)
        if others is None:
            yield UNKNOWN
            continue
        surface = Surface.sampled(others.vertices, others.normals, POINTS)
        asked = subsample_views(frames, segment, ASKED)
        moves = [compose(register_to_model(surface, view, T), inverse(T)) for view, T in asked]
        turn = float(np.median([rotation_angle(move[:3, :3]) for move in moves]))
        yield SegmentEvidence(
            turn, min(rotation_cost_profile(surface, asked, axis, point, SEGMENT_TURNS_DEG))
        )


def _segments(stamps_ns: Sequence[int]) -> list[list[int]]:
    """Indices of the frames of each stretch in sight, or of each third of a scan that has but one."""
    order = np.argsort(stamps_ns, kind='stable')
    apart = np.diff(np.asarray(stamps_ns)[order])
    gaps = np.flatnonzero(apart > max(APART_NS, APART * float(np.median(apart)))) + 1
    parts = np.split(order, gaps) if len(gaps) else np.array_split(order, PARTS)
    return [part.tolist() for part in parts if len(part)]
