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

"""What the frames say of a scan: could the rotation be seen, and does the model explain what was seen?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.frame_store import StoredFrame
from debris_scanner.frames import TargetFrame
from debris_scanner.fusion import FusedSurface
from debris_scanner.geometry import Array, apply, compose, exp_se3, inverse, rotation_angle
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.normals import NormalSettings
from debris_scanner.observability import rotation_observability
from debris_scanner.registration import Agreement, linearise, solve_step
from debris_scanner.views import Surface, View

FRAMES = 40  # that are asked, drawn evenly
POINTS = 3000  # of the model that each is asked about
GATE = 0.008  # m
SETTLING_GATES = (0.02, 0.012, 0.012, 0.008, 0.008)  # m
OBSERVABILITY_GATE = 0.012  # m
MIN_MATCHES = 50


@dataclass(frozen=True)
class FrameEvidence:
    """How a frame agrees with the model, and how far it moves when it is registered to the model alone."""

    agreement: Agreement
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
    for n in drawn_evenly(len(stored), FRAMES):
        item = stored[n]
        order = np.argsort(np.abs(stamps - item.stamp_ns))
        nearest = next((int(k) for k in order if stamps[k] != item.stamp_ns), None)
        if nearest is None:
            continue
        view, T = View(item.restore(normals)), item.pose(poses)
        T_reference = keyframes.frames[nearest].T_target_sensor
        lin = linearise(view, T, keyframes.views[nearest], T_reference, OBSERVABILITY_GATE)
        if lin.agreement.matched > MIN_MATCHES:
            values.append(rotation_observability(lin.H, lin.agreement.matched, view, T))
    return values


def model_evidence(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> list[FrameEvidence]:
    """What some of the posed frames (T_target_sensor) that a surface was made from say of it."""
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    centre = surface.points.mean(axis=0).astype(np.float64)
    evidence = []
    for n in drawn_evenly(len(frames), FRAMES):
        view, T = View(frames[n][0]), frames[n][1]
        agreement = linearise(surface, np.eye(4), view, T, GATE).agreement
        T_settled = settled(surface, view, T)
        move = compose(T_settled, inverse(T))
        there = linearise(surface, np.eye(4), view, T_settled, GATE)
        shift = _held_length(apply(move, centre) - centre, there.H[3:, 3:])
        gain = misfit(agreement) / misfit(there.agreement)
        evidence.append(FrameEvidence(agreement, rotation_angle(move[:3, :3]), gain, shift))
    return evidence


def misfit(agreement: Agreement) -> float:
    """Mean square distance (m²) of the model in view from a frame, each point's at most the gate's."""
    a = agreement
    return a.explained * min(a.rms, GATE) ** 2 + (1 - a.explained) * GATE**2


def _held_length(shift: Array, information: Array) -> float:
    """Length of a shift (3,), its parts weighted by their information (3, 3), the best known by 1."""
    best = max(float(np.linalg.eigvalsh(information)[-1]), 1e-12)
    return float(np.sqrt(max(0.0, float(shift @ information @ shift)) / best))


def settled(surface: Surface, view: View, T_target_view: Array) -> Array:
    """Pose (4, 4) that a view comes to rest at when it is registered to the surface alone."""
    for gate in SETTLING_GATES:
        lin = linearise(surface, np.eye(4), view, T_target_view, gate)
        # the twist moves the surface; the view moves the other way
        T_target_view = compose(exp_se3(-solve_step(lin.H, lin.g)), T_target_view)
    return T_target_view


def drawn_evenly(count: int, most: int) -> list[int]:
    """Indices of so many out of a number, evenly spread."""
    return [int(n) for n in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))]


def drawn_views(
    frames: Sequence[tuple[TargetFrame, Array]], indices: Sequence[int], most: int
) -> list[tuple[View, Array]]:
    """Views and poses (T_target_view) of so many of the posed frames with these indices, evenly spread."""
    drawn = (frames[indices[n]] for n in drawn_evenly(len(indices), most))
    return [(View(frame), T) for frame, T in drawn]
