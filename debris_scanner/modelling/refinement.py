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

"""Model refinement: frame poses against their key frames, fused surface, cloud, mesh and colour."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import ClosedMesh, KeyFrame, KeyPose, Model, TargetFrame
from debris_scanner.core.geometry import (
    Array,
    apply,
    area,
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_so3,
    rotation_angle,
    transform,
)
from debris_scanner.core.voxel_grid import voxel_grid_with_normals
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.modelling.closing import open_mesh, parts
from debris_scanner.modelling.consistency import a_point
from debris_scanner.modelling.frame_store import StoredFrame
from debris_scanner.modelling.fusion import FusedSurface, FusionSettings, Volume, bounds
from debris_scanner.registration.likelihood import BeamModel, pair_likelihood
from debris_scanner.registration.projective import linearise, linearise_pairs, solve_step
from debris_scanner.registration.view_table import ViewTable
from debris_scanner.sensing.sensor_model import SensorModel
from debris_scanner.sensing.views import Surface, View

MIN_PART = 0.01  # parts of the mesh smaller than this share of the largest are noise
NEIGHBOURS = 4
SLIPPED = np.radians(3.0)  # from further away a registration may not find back
TOGETHER = 16  # frames that are registered at once: their views take some 20 MB
REFINE_GATES = (5.5, 4.0)  # px
CLOUD_SPACING = 4 / 3  # voxels of the field between points of the model cloud
# Of the fused surface's area: where few voxels are measured, closing cannot tell what was seen.
LEAST_SEEN = 0.5
SEEN_WITHIN = 6.7  # px in depth, of a point that a key frame saw


def interpolated(frames: Sequence[StoredFrame], keyframes: Sequence[KeyPose], centre: Array) -> list[Array]:
    """T_target_sensor (4, 4) of frames, so that the way they were tracked leads from key frame to key frame.

    What relaxation moved the later key frame by, as seen from the earlier one, is spread evenly over the time
    between them. Where that is far, tracking had slipped, and the way is taken to be straight.

    Args:
        frames: as they were tracked.
        keyframes: relaxed, in order of time.
        centre: (3,) of the target, about which the correction turns.
    """
    poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
    after = {a.stamp_ns: b for a, b in pairwise(keyframes) if b.T_previous is not None}
    return [
        f.pose(poses)
        if f.keyframe_ns is None or f.keyframe_ns not in after
        else _on_the_way(f, poses[f.keyframe_ns], after[f.keyframe_ns], centre)
        for f in frames
    ]


def _on_the_way(frame: StoredFrame, T_a: Array, b: KeyPose, centre: Array) -> Array:
    """T_target_sensor (4, 4) of a frame tracked from a key frame a at a pose (4, 4) to the next one, b."""
    assert frame.keyframe_ns is not None and b.T_previous is not None
    share = (frame.stamp_ns - frame.keyframe_ns) / (b.stamp_ns - frame.keyframe_ns)
    led_to, T = compose(T_a, b.T_previous), compose(T_a, frame.T)
    if _turn(led_to, b.T_target_sensor) > SLIPPED:
        led_to = T = T_a
    astray = compose(b.T_target_sensor, inverse(led_to))
    # the target's centre goes straight, as the sensor sees it
    seen = apply(inverse(T), centre)
    seen = seen + share * (apply(inverse(b.T_target_sensor), centre) - apply(inverse(led_to), centre))
    R = exp_so3(share * log_so3(astray[:3, :3])) @ T[:3, :3]
    return transform(R, centre - R @ seen)


def refined_poses(
    frames: Sequence[StoredFrame],
    starts: Sequence[Array],
    view_of: Callable[[StoredFrame], View],
    keyframes: KeyFrameSet,
    sensor: SensorModel,
    progress: Callable[[str, int, int], None],
) -> list[tuple[Array, Array]]:
    """Poses of frames registered to the key frames, and their information, as by :func:`refine_pose`.

    Where tracking slipped between two key frames, nobody knows when. So a frame may begin, too, where the one
    before it came out, moved on as it was tracked: what fits better holds.

    Args:
        frames: in order of time, as they were tracked.
        starts: T_target_sensor of each (4, 4).
        view_of: makes the view of a frame.
        keyframes: relaxed.
        sensor: noise measured on the stream.
        progress: is told how many frames are done.
    """
    registered: list[tuple[Array, Array]] = []
    each = zip(frames, starts, _refined(frames, starts, view_of, keyframes), strict=True)
    for n, (frame, T, (view, found)) in enumerate(each):
        if n and frame.keyframe_ns is not None and frame.keyframe_ns == frames[n - 1].keyframe_ns:
            on = compose(registered[-1][0], inverse(frames[n - 1].T), frame.T)
            if _turn(on, T) > SLIPPED:
                rival = refine_pose(view, on, keyframes, keyframes.centre)
                found = max(found, rival, key=lambda f: _fit(view, f[0], keyframes, sensor))
        registered.append(found)
        progress('refine', n + 1, len(frames))
    return registered


def _refined(
    frames: Sequence[StoredFrame],
    starts: Sequence[Array],
    view_of: Callable[[StoredFrame], View],
    keyframes: KeyFrameSet,
) -> Iterator[tuple[View, tuple[Array, Array]]]:
    """Each frame's view, and what :func:`refine_pose` makes of where it begins."""
    for first in range(0, len(frames), TOGETHER):
        views = [view_of(frame) for frame in frames[first : first + TOGETHER]]
        found = refine_poses(views, starts[first : first + TOGETHER], keyframes, keyframes.centre)
        yield from zip(views, found, strict=True)


def _turn(T_a: Array, T_b: Array) -> float:
    """Angle between two attitudes, rad."""
    return rotation_angle(T_a[:3, :3].T @ T_b[:3, :3])


def _fit(view: View, T: Array, keyframes: KeyFrameSet, sensor: SensorModel) -> float:
    """How well a view at a pose (4, 4) agrees with the key frames, nats a point."""
    beam = BeamModel.of(sensor, [view])
    return a_point(
        [
            pair_likelihood(
                view, T, keyframes.views[k], keyframes.frames[k].T_target_sensor, beam, keyframes.centre
            )
            for k in _nearest(T, keyframes, keyframes.centre)
        ]
    )


def pose_frames(frames: Sequence[StoredFrame], refined: dict[int, Array]) -> None:
    """Pose frames as refined; those between go on from the one before them as they were tracked.

    Args:
        frames: in order of time; frames of a key frame of which none is refined stay as they are.
        refined: T_target_sensor (4, 4) by stamp.
    """
    keyframe_ns, T_target_keyframe = None, np.eye(4)
    for frame in frames:
        if frame.stamp_ns in refined:
            T = refined[frame.stamp_ns]
            keyframe_ns, T_target_keyframe = frame.keyframe_ns, compose(T, inverse(frame.T))
            frame.keyframe_ns, frame.T = None, T
        elif frame.keyframe_ns is not None and frame.keyframe_ns == keyframe_ns:
            frame.keyframe_ns, frame.T = None, compose(T_target_keyframe, frame.T)


def refine_pose(
    view: View, T_target_view: Array, keyframes: KeyFrameSet, centre: Array
) -> tuple[Array, Array]:
    """Pose (4, 4) of a frame registered to the key frames of nearest view directions, held fixed.

    Returns:
        T_target_view, and its information (6, 6) for a left twist.
    """
    return refine_poses([view], [T_target_view], keyframes, centre)[0]


def refine_poses(
    views: Sequence[View], poses: Sequence[Array], keyframes: KeyFrameSet, centre: Array
) -> list[tuple[Array, Array]]:
    """:func:`refine_pose` of many frames, each by itself."""
    nearest = [_nearest(T, keyframes, centre) for T in poses]
    used = list(dict.fromkeys(k for of_frame in nearest for k in of_frame))
    place = {k: len(views) + n for n, k in enumerate(used)}
    table = ViewTable([*views, *(keyframes.views[k] for k in used)])
    fixed = [keyframes.frames[k].T_target_sensor for k in used]
    pairs = [(n, place[k]) for n, of_frame in enumerate(nearest) for k in of_frame]
    moved, H = list(poses), np.zeros((len(views), 6, 6))
    for gate in REFINE_GATES:
        H, g = np.zeros((len(views), 6, 6)), np.zeros((len(views), 6))
        for (n, _), pair in zip(pairs, linearise_pairs(table, [*moved, *fixed], pairs, gate), strict=True):
            H[n], g[n] = H[n] + pair.H, g[n] + pair.g
        moved = [compose(exp_se3(solve_step(A, b)), T) for A, b, T in zip(H, g, moved, strict=True)]
    return list(zip(moved, H, strict=True))


def _nearest(T: Array, keyframes: KeyFrameSet, centre: Array) -> list[int]:
    """Key frames, by index, that look from directions nearest to a pose's (4, 4)."""
    angles = keyframes.view_angles(T, centre)
    return [int(k) for k in np.argsort(angles, kind='stable')[:NEIGHBOURS] if np.isfinite(angles[k])]


def refine_to_model(view: View, T_model_view: Array, surface: Surface) -> tuple[Array, Array]:
    """Pose (4, 4) of a frame registered to a model's surface, and its information (6, 6); see above."""
    T, H = T_model_view, np.zeros((6, 6))
    for gate in REFINE_GATES:
        lin = linearise(surface, np.eye(4), view, T, gate)
        H = lin.H
        T = compose(exp_se3(solve_step(H, -lin.g)), T)
    return T, H


def integrated(
    frames: Sequence[tuple[TargetFrame, Array]], settings: FusionSettings, measured: bool = True
) -> Volume:
    """The field of posed frames (T_target_sensor); rendered ones show backs of surfaces, without a plane."""
    step = max(1, len(frames) // 30)
    sample = list(frames[::step])  # asked three times
    low, high = bounds(sample)
    footprint = float(np.median([frame.footprint for frame, _ in sample]))
    volume = Volume(low, high, settings, footprint)
    for frame, T in frames:
        volume.integrate(frame, T)
    if measured:
        volume.integrate_thin(frames)
    return volume


def fuse(frames: Sequence[tuple[TargetFrame, Array]], settings: FusionSettings) -> FusedSurface | None:
    """Surface of posed frames (T_target_sensor), without small disconnected parts; None if there is none."""
    return large_parts(integrated(frames, settings).surface())


def large_parts(surface: FusedSurface | None) -> FusedSurface | None:
    """A surface without its small connected components; None if all are small."""
    if surface is None:
        return None
    part = parts(surface.triangles, len(surface.vertices))
    sizes = np.bincount(part)
    keep = sizes[part] >= max(50, MIN_PART * sizes.max())
    if not keep.any():
        return None
    used, triangles = np.unique(surface.triangles[keep], return_inverse=True)
    return FusedSurface(
        surface.vertices[used],
        surface.normals[used],
        triangles.reshape(-1, 3).astype(np.int32),
        surface.voxel,
    )


def make_model(
    surface: FusedSurface,
    keyframes: Iterable[KeyFrame],
    origin: Array | None,
    closed: ClosedMesh | None = None,
) -> tuple[Model, Array]:
    """Model of a fused surface and the shift (3,) that was subtracted to put its origin.

    Args:
        surface: in the key frames' target frame.
        keyframes: with poses in that frame; the source of the colour, if they have any.
        origin: new origin in the old target frame; None takes the centroid of the cloud.
        closed: of the same field; what was seen of it becomes the mesh.
    """
    points, normals = voxel_grid_with_normals(
        surface.vertices, surface.normals, CLOUD_SPACING * surface.voxel
    )
    facing = normals.any(axis=1)  # opposite sides of a plate thinner than a voxel cancel
    points, normals = points[facing], normals[facing]
    shift = points.mean(axis=0, dtype=np.float64) if origin is None else origin
    keyframes = list(keyframes)
    vertices, triangles, vertex_rgb = surface.vertices, surface.triangles, None
    if closed is not None:
        seen, shown = open_mesh(closed)
        if area(closed.vertices[seen], shown) < LEAST_SEEN * area(vertices, triangles):
            closed = None
    if closed is None:
        vertex_rgb = colour(vertices, surface.normals, keyframes)
    else:
        closed = replace(closed, rgb=colour(closed.vertices, closed.normals, keyframes))
        vertices, triangles = closed.vertices[seen], shown
        vertex_rgb = None if closed.rgb is None else closed.rgb[seen]
        closed = replace(closed, vertices=(closed.vertices - shift).astype(np.float32))
    model = Model(
        points=(points - shift).astype(np.float32),
        normals=normals,
        vertices=(vertices - shift).astype(np.float32),
        triangles=triangles,
        rgb=colour(points, normals, keyframes),
        vertex_rgb=vertex_rgb,
        closed=closed,
    )
    return model, shift


def colour(
    points: NDArray[np.floating], normals: NDArray[np.floating], keyframes: Iterable[KeyFrame]
) -> np.ndarray | None:
    """Mean colour (n, 3) uint8 of points as the key frames saw them; None if they saw none."""
    total, count = np.zeros((len(points), 3)), np.zeros(len(points))
    coloured = False
    for k in keyframes:
        if k.frame.rgb is None:
            continue
        coloured = True
        T, c = inverse(k.T_target_sensor), k.frame.camera
        p, n = points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
        u = np.rint(p[:, 0] / p[:, 2] * c.fx + c.cx).astype(int)
        v = np.rint(p[:, 1] / p[:, 2] * c.fy + c.cy).astype(int)
        seen = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height) & ((n * p).sum(axis=1) < 0)
        u, v = np.where(seen, u, 0), np.where(seen, v, 0)
        seen &= np.abs(k.frame.depth[v, u] - p[:, 2]) < SEEN_WITHIN * k.frame.footprint
        total[seen] += k.frame.rgb[v[seen], u[seen]]
        count[seen] += 1
    if not coloured:
        return None
    grey = np.full(3, 128.0)
    mean = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], grey)
    return np.asarray(np.clip(np.rint(mean), 0, 255), dtype=np.uint8)
