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

"""Rotational symmetry of a model: turned by a full turn over n about a principal axis, is it the same?

An attitude of such a target is known up to its symmetry only; which of its equals is meant, continuity tells.

Could frames as well have been taken of the target turned by a part of a full turn?

Where submaps were joined by their looks alone, nothing else tells such a turn from none: of a box that was
lost and found again it can't be known which of its like sides was seen before.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.frames import Model, TargetFrame
from debris_scanner.core.geometry import Array, apply, compose, exp_se3, exp_so3, rotation_angle, transform
from debris_scanner.modelling.evidence import FrameEvidence, model_evidence
from debris_scanner.modelling.fusion import FusedSurface

ORDERS = (12, 8, 6, 5, 4, 3, 2)  # tried in this order; a body of revolution passes the first
POINTS = 2000
FITTED = 500  # of them
SAME = 0.002  # m between surfaces that are the same
NEAR = 0.012  # m: further from any point there is no surface
BESIDE = 0.005  # m: no surface is under a point so far beside the nearest of its points: it was never seen
SHARE = 0.98  # of the points that must find the surface again
ITERATIONS = 25
SETTLED = 1e-4  # rad and m, of one iteration
TURNED = np.radians(3.0)  # a fit that turned by more than this off a part of the full turn slid away
TILTED = np.radians(15.0)  # the principal axes of what was seen are known to this


def rotational_symmetry(model: Model) -> int | None:
    """The highest order n of a rotation about a principal axis that maps the model onto itself, or None."""
    turns = turns_onto_itself(model.points, model.normals)
    return next((n for n, _, share in turns if share >= SHARE), None)


def turns_onto_itself(
    points: NDArray[np.float32], normals: NDArray[np.float32]
) -> Iterator[tuple[int, Array, float]]:
    """Motions that bring a surface nearly onto itself, by falling order.

    Args:
        points: (n, 3), metres.
        normals: (n, 3), unit.

    Yields:
        Order n of the full turn's part, the motion (4, 4), and the share of the points that meet the surface.
    """
    surface, directions = points.astype(np.float64), normals.astype(np.float64)
    centre = surface.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(surface.T))
    tree = cKDTree(surface)
    rng = np.random.default_rng(0)
    drawn = surface[rng.choice(len(surface), min(POINTS, len(surface)), replace=False)]
    for n in ORDERS:
        for axis in axes.T:
            R = exp_so3(2 * np.pi / n * axis)
            start = transform(R, centre - R @ centre)
            fitted = _fitted(drawn, surface, directions, tree, start)
            if fitted is not None:
                T, share = fitted
                slid = abs(rotation_angle(T[:3, :3]) - 2 * np.pi / n) > TURNED
                if not slid and rotation_angle(T[:3, :3] @ R.T) < 2 * TILTED:
                    yield n, T, share


def _fitted(
    drawn: Array, points: Array, normals: Array, tree: cKDTree, T: Array
) -> tuple[Array, float] | None:
    """The motion fitted (point to plane), and which share of the points then meets the surface."""
    for _ in range(ITERATIONS):
        turned = apply(T, drawn[:FITTED])
        apart, k = tree.query(turned, distance_upper_bound=NEAR)
        near = np.isfinite(apart)
        if near.mean() < 0.5:
            return None
        x, n = turned[near], normals[k[near]]
        r = ((x - points[k[near]]) * n).sum(axis=1)
        above = apart[near] ** 2 - r**2 < BESIDE**2
        J = np.concatenate([np.cross(x, n), n], axis=1)[above]
        step = -np.linalg.lstsq(J, r[above], rcond=1e-6)[0]
        T = compose(exp_se3(step), T)
        if np.abs(step).max() < SETTLED:
            break
    turned = apply(T, drawn)
    apart, k = tree.query(turned, distance_upper_bound=NEAR)
    near = np.isfinite(apart)
    level = np.abs(((turned[near] - points[k[near]]) * normals[k[near]]).sum(axis=1))
    return T, float((level < SAME).sum() / len(turned))


ALIKE = 0.5  # of the surface meets itself: worth asking the frames, of which some parts were never seen
EXPLAINED = 0.03  # less of the surface in view may match once it is turned,
CONTRADICTED = 0.01  # more of it lie where nothing was seen: means over the frames;
DRAWN = np.radians(1.3)  # and by so much more may it draw them to another attitude (90th percentile)


def is_rotationally_ambiguous(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> bool:
    """Whether a surface, turned, explains the frames (posed T_target_sensor) it was made from as well."""
    own = _figures(model_evidence(fused, frames))
    for _, T, share in turns_onto_itself(fused.vertices, fused.normals):
        if share < ALIKE:
            continue
        vertices, normals = apply(T, fused.vertices), fused.normals @ T[:3, :3].T
        turned = FusedSurface(vertices.astype(np.float32), normals.astype(np.float32), fused.triangles)
        explained, contradicted, drawn = _figures(model_evidence(turned, frames))
        if explained > own[0] - EXPLAINED and contradicted < own[1] + CONTRADICTED and drawn < own[2] + DRAWN:
            return True
    return False


def _figures(evidence: Sequence[FrameEvidence]) -> tuple[float, float, float]:
    edge_stats = [e.stats for e in evidence]
    explained = np.mean([a.visible_inlier_ratio for a in edge_stats])
    contradicted = np.mean([a.conflict_ratio + a.silhouette_violation_ratio for a in edge_stats])
    return float(explained), float(contradicted), float(np.percentile([e.turn for e in evidence], 90))
