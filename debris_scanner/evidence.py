"""What the frames say of a scan: could the rotation be seen, and does the model explain what was seen?"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.frame_store import StoredFrame
from debris_scanner.frames import TargetFrame
from debris_scanner.fusion import FusedSurface
from debris_scanner.geometry import Array
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.normals import NormalSettings
from debris_scanner.observability import rotation_observability
from debris_scanner.registration import Agreement, linearise
from debris_scanner.views import Surface, View

FRAMES = 40  # that are asked, drawn evenly
POINTS = 3000  # of the model that each is asked about
GATE = 0.008  # m
OBSERVABILITY_GATE = 0.012  # m
MIN_MATCHES = 50


def rotation_evidence(
    stored: Sequence[StoredFrame], keyframes: KeyFrameSet, normals: NormalSettings
) -> list[float]:
    """Rotation information of some frames, each against the key frame nearest in time."""
    if not stored or not len(keyframes):
        return []
    poses = {k.stamp_ns: k.T_target_sensor for k in keyframes.frames}
    stamps = np.array([k.stamp_ns for k in keyframes.frames])
    values = []
    for n in _drawn(len(stored)):
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


def model_evidence(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> list[Agreement]:
    """How a fused surface agrees with some of the posed frames (T_target_sensor) that it was made from."""
    surface = Surface.sampled(fused.vertices, fused.normals, POINTS)
    agreements = []
    for n in _drawn(len(frames)):
        frame, T_target_sensor = frames[n]
        agreements.append(linearise(surface, np.eye(4), View(frame), T_target_sensor, GATE).agreement)
    return agreements


def _drawn(count: int) -> list[int]:
    return [int(n) for n in np.unique(np.linspace(0, count - 1, min(count, FRAMES)).astype(int))]
