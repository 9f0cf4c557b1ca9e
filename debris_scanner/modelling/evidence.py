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

"""Evidence for and against a scan's model: is the rotation observable, and does the model explain the frames?

Three questions, each answered with numbers that :mod:`validation` judges:

* How much rotation information have the frames (:func:`rotation_evidence`)? The information at the pose gives
  the sharpness of the minimum. Whether it is the only one is shown by :func:`profile_weakest_axis`: how much
  worse the frames fit a model rotated about its least observable axis.
* Does each frame agree with the model, and how large is its pose correction (:func:`model_evidence`)?
* Does each segment of the scan agree with a model of the other segments (:func:`segment_evidence`)? A model
  explains the segment that it was made from at any pose; only the others can confirm it. This decides where a
  single frame cannot: a round flank slides when it is registered to the model, however right its pose.
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
    register,
    rotation_observability,
    solve_step,
)
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View

NEIGHBOURS = 16  # pairs of key frames, evenly spread
FRAMES = 40  # compared with the model, evenly spread
POINTS = 3000  # of the model, compared with each frame
GATE = 5.5  # px
MODEL_GATES = (13.0, 8.0, 8.0, 5.5, 5.5)  # px
OBSERVABILITY_GATE = 8.0  # px
MIN_MATCHES = 50
PROFILE_FRAMES = 12  # for the cost profile, evenly spread
PROFILE_TURNS_DEG = (-30, -20, -10, 10, 20, 30)
# Segments are apart by more than both bounds; the second one is for slow targets, with few key frames.
SEGMENT_GAP_NS = 1_000_000_000
SEGMENT_GAP_INTERVALS = 5.0  # median intervals between frames
PARTS = 3  # segments of a scan without gaps
FUSED = 80  # frames fused of the other segments, evenly spread
SEGMENT_FRAMES = 8  # compared a segment, and for the axis
SEGMENT_TURNS_DEG = tuple(turn for turn in range(-180, 180, 10) if turn)


@dataclass(frozen=True)
class FrameEvidence:
    """How a frame agrees with the model, and its pose correction when registered to the model alone."""

    stats: RegistrationStats
    turn: float  # rad
    gain: float  # factor by which the correction improves the fit; about 1 where a round flank slides
    shift: float  # px, of the model's centre, weighted by information: a face is uninformative along itself


def rotation_evidence(
    stored: Sequence[StoredFrame], keyframes: KeyFrameSet, normals: NormalSettings
) -> list[float]:
    """Rotation information of a sample of frames, each against the key frame nearest in time."""
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


def neighbour_evidence(keyframes: KeyFrameSet) -> list[RegistrationStats]:
    """How neighbouring key frames agree once registered to each other: what this sensor and target allow.

    Neighbours are some degrees apart and right in any scan, also in one whose loop was closed wrongly.
    """
    linked = [k for k in keyframes.active[1:] if keyframes.frames[k].linked]
    stats = []
    for n in subsample_indices(len(linked), NEIGHBOURS):
        k = linked[n]
        T, T_before = keyframes.frames[k].T_target_sensor, keyframes.frames[k - 1].T_target_sensor
        found = register(keyframes.views[k], T, keyframes.views[k - 1], T_before)
        if found is not None:
            stats.append(found[1].stats)
    return stats


def model_evidence(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> list[FrameEvidence]:
    """Evidence of a sample of the posed frames (T_target_sensor) that a surface was made from."""
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    centre = surface.points.mean(axis=0).astype(np.float64)
    evidence = []
    for n in subsample_indices(len(frames), FRAMES):
        view, T = View(frames[n][0]), frames[n][1]
        stats = linearise(surface, np.eye(4), view, T, GATE).stats
        T_corrected = register_to_model(surface, view, T)
        correction = compose(T_corrected, inverse(T))
        corrected = linearise(surface, np.eye(4), view, T_corrected, GATE)
        shift = _informed_length(apply(correction, centre) - centre, corrected.H[3:, 3:]) / view.footprint
        gain = misfit(stats) / misfit(corrected.stats)
        evidence.append(FrameEvidence(stats, rotation_angle(correction[:3, :3]), gain, shift))
    return evidence


def misfit(stats: RegistrationStats) -> float:
    """Mean square distance (px²) of the visible model from a frame, each point's clipped at the gate."""
    a = stats
    return a.visible_inlier_ratio * min(a.rms, GATE) ** 2 + (1 - a.visible_inlier_ratio) * GATE**2


def register_to_model(surface: Surface, view: View, T_target_view: Array) -> Array:
    """Pose (4, 4) of a view after registration to the surface alone."""
    for gate in MODEL_GATES:
        lin = linearise(surface, np.eye(4), view, T_target_view, gate)
        # the twist moves the surface; the view moves the other way
        T_target_view = compose(exp_se3(-solve_step(lin.H, lin.g)), T_target_view)
    return T_target_view


def subsample_indices(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` indices, evenly spread."""
    return [int(n) for n in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))]


def subsample_views(
    frames: Sequence[tuple[TargetFrame, Array]], indices: Sequence[int], most: int
) -> list[tuple[View, Array]]:
    """Views and poses (T_target_view) of at most ``most`` frames of these indices, evenly spread."""
    sample = (frames[indices[n]] for n in subsample_indices(len(indices), most))
    return [(View(frame), T) for frame, T in sample]


@dataclass(frozen=True)
class RotationCostProfile:
    """Mean cost of the frames once the model is rotated about its weakest axis, relative to none."""

    axis: Array  # (3,), unit, target frame
    turns_deg: tuple[int, ...]
    costs: tuple[float, ...]  # 1 where the rotation cannot be seen

    @property
    def least(self) -> float:
        """Least cost of all rotations."""
        return min(self.costs)


def profile_weakest_axis(
    fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]
) -> RotationCostProfile:
    """Rotate posed frames (T_target_sensor) about the model's weakest axis, and compute the cost.

    The cost of a visible point of the model is its squared distance, clipped at the gate.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    sample = subsample_views(frames, range(len(frames)), PROFILE_FRAMES)
    axis, point = weakest_axis(surface, sample)
    return RotationCostProfile(
        axis, PROFILE_TURNS_DEG, rotation_cost_profile(surface, sample, axis, point, PROFILE_TURNS_DEG)
    )


def weakest_axis(surface: Surface, sample: Sequence[tuple[View, Array]]) -> tuple[Array, Array]:
    """Axis (3,) of least rotation information, translation marginalised, and a point (3,) on it.

    The point matters: rotated about a line beside its axis a cylinder moves sideways, which is visible.
    """
    centre = surface.points.mean(axis=0).astype(np.float64)
    H = sum((linearise(surface, np.eye(4), view, T, GATE).H for view, T in sample), np.zeros((6, 6)))
    rotation, shift = marginal_rotation(H, centre)
    axis = np.linalg.eigh(rotation)[1][:, 0]
    return axis, centre + np.cross(axis, shift @ axis)


def rotation_cost_profile(
    surface: Surface,
    sample: Sequence[tuple[View, Array]],
    axis: Array,
    point: Array,
    turns_deg: Sequence[float],
) -> tuple[float, ...]:
    """Mean cost of posed views (T_target_view) once the surface is rotated, relative to none."""
    turns = [exp_so3(np.radians(turn) * axis) for turn in turns_deg]
    about = [transform(R, point - R @ point) for R in turns]
    here = _cost(surface, sample, np.eye(4))
    return tuple(_cost(surface, sample, T) / here for T in about)


@dataclass(frozen=True)
class SegmentEvidence:
    """How a segment agrees with a model of the other segments."""

    turn: float  # rad, rotation of the frames when registered to that model (median)
    least_cost: float  # of rotating it by 10 to 180 degrees about the weakest axis, relative to none


UNKNOWN = SegmentEvidence(np.pi, 0.0)


def segment_evidence(
    fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]], settings: FusionSettings
) -> Iterator[SegmentEvidence]:
    """Evidence of each segment of posed frames (T_target_sensor) against a model of the other segments.

    A segment that the others never saw registers at random, and is not confirmed.
    """
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    axis, point = weakest_axis(surface, subsample_views(frames, range(len(frames)), SEGMENT_FRAMES))
    for segment in _segments([frame.stamp_ns for frame, _ in frames]):
        rest = np.setdiff1d(np.arange(len(frames)), segment)
        others = fuse([frames[rest[n]] for n in subsample_indices(len(rest), FUSED)], settings)
        if others is None:
            yield UNKNOWN
            continue
        surface = Surface.sampled(others.vertices, others.normals, POINTS)
        sample = subsample_views(frames, segment, SEGMENT_FRAMES)
        moves = [compose(register_to_model(surface, view, T), inverse(T)) for view, T in sample]
        turn = float(np.median([rotation_angle(move[:3, :3]) for move in moves]))
        yield SegmentEvidence(
            turn, min(rotation_cost_profile(surface, sample, axis, point, SEGMENT_TURNS_DEG))
        )


def _informed_length(shift: Array, information: Array) -> float:
    """Length of a shift (3,) weighted by its information (3, 3), the best known direction by 1."""
    best = max(float(np.linalg.eigvalsh(information)[-1]), 1e-12)
    return float(np.sqrt(max(0.0, float(shift @ information @ shift)) / best))


def _cost(surface: Surface, sample: Sequence[tuple[View, Array]], T_turned: Array) -> float:
    T_back = inverse(T_turned)
    turned = ((view, compose(T_back, T)) for view, T in sample)
    return float(np.mean([misfit(linearise(surface, np.eye(4), v, T, GATE).stats) for v, T in turned]))


def _segments(stamps_ns: Sequence[int]) -> list[list[int]]:
    """Indices of the frames of each segment between gaps, or of each third of a scan without gaps."""
    order = np.argsort(stamps_ns, kind='stable')
    intervals = np.diff(np.asarray(stamps_ns)[order])
    gaps = (
        np.flatnonzero(intervals > max(SEGMENT_GAP_NS, SEGMENT_GAP_INTERVALS * float(np.median(intervals))))
        + 1
    )
    parts = np.split(order, gaps) if len(gaps) else np.array_split(order, PARTS)
    return [part.tolist() for part in parts if len(part)]
