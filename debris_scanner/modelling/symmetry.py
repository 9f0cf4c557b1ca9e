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

"""Rotational symmetry of a model.

A model is symmetric if a rotation by a full turn over n about a principal axis maps it onto itself. The
attitude of such a target is known up to its symmetry only; continuity decides which equivalent is meant.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    exp_se3,
    exp_so3,
    log_so3,
    rotation_angle,
    transform,
)

ORDERS = (12, 8, 6, 5, 4, 3, 2)  # tested in this order; a body of revolution passes the first
POINTS = 2000
FITTED = 500  # of them, for the fit
# Lengths in spacings of the surface's points.
SAME = 1.0  # largest distance between equal surfaces
NEAR = 6.0  # largest distance of a match
BESIDE = 2.5  # a point so far beside its nearest one lies above unobserved surface
SHARE = 0.98  # of the points of a symmetric model that meet the surface
ITERATIONS = 25
CONVERGED_RAD, CONVERGED = 1e-4, 0.05  # of one iteration
TURNED = np.radians(3.0)  # a fit whose angle differs more from a full turn over n has slid
TILTED = np.radians(15.0)  # accuracy of the principal axes of an incomplete model


def rotational_symmetry(model: Model) -> int | None:
    """The highest order n of a rotation about a principal axis that maps the model onto itself, or None."""
    turns = turns_onto_itself(model.points, model.normals, model.spacing)
    return next((n for n, _, share in turns if share >= SHARE), None)


def turns_onto_itself(
    points: NDArray[np.float32], normals: NDArray[np.float32], spacing: float
) -> Iterator[tuple[int, Array, float]]:
    """Motions that map a surface nearly onto itself, by decreasing order.

    Args:
        points: (n, 3), metres.
        normals: (n, 3), unit.
        spacing: of the model's points, metres.

    Yields:
        Order n, the motion (4, 4), and the share of the points that then meet the surface.
    """
    surface, directions = points.astype(np.float64), normals.astype(np.float64)
    centre = surface.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(surface.T))
    tree = scipy.spatial.cKDTree(surface)
    rng = np.random.default_rng(0)
    sample = surface[rng.choice(len(surface), min(POINTS, len(surface)), replace=False)]
    for n in ORDERS:
        for axis in axes.T:
            R = exp_so3(2 * np.pi / n * axis)
            start = transform(R, centre - R @ centre)
            fitted = _fitted(sample, surface, directions, tree, start, spacing)
            if fitted is not None:
                T, share = fitted
                slid = abs(rotation_angle(T[:3, :3]) - 2 * np.pi / n) > TURNED
                if not slid and rotation_angle(T[:3, :3] @ R.T) < 2 * TILTED:
                    yield n, T, share


def _fitted(
    sample: Array, points: Array, normals: Array, tree: 'scipy.spatial.cKDTree', T: Array, spacing: float
) -> tuple[Array, float] | None:
    """The motion after a point-to-plane fit, and the share of the points that then meets the surface."""
    for _ in range(ITERATIONS):
        turned = apply(T, sample[:FITTED])
        apart, k = tree.query(turned, distance_upper_bound=NEAR * spacing)
        near = np.isfinite(apart)
        if near.mean() < 0.5:
            return None
        x, n = turned[near], normals[k[near]]
        r = ((x - points[k[near]]) * n).sum(axis=1)
        above = apart[near] ** 2 - r**2 < (BESIDE * spacing) ** 2
        J = np.concatenate([np.cross(x, n), n], axis=1)[above]
        step = -np.linalg.lstsq(J, r[above], rcond=1e-6)[0]
        T = compose(exp_se3(step), T)
        if np.abs(step[:3]).max() < CONVERGED_RAD and np.abs(step[3:]).max() < CONVERGED * spacing:
            break
    return T, _meeting(apply(T, sample), points, normals, tree, spacing)


def meeting_share(
    points: NDArray[np.float32], normals: NDArray[np.float32], spacing: float, T: Array
) -> float:
    """Share of a surface's points that meet the surface again after a motion (4, 4)."""
    surface = points.astype(np.float64)
    sample = surface[:: max(1, len(surface) // POINTS)]
    tree = scipy.spatial.cKDTree(surface)
    return _meeting(apply(T, sample), surface, normals.astype(np.float64), tree, spacing)


@dataclass(frozen=True)
class Symmetry:
    """How a surface is turned onto itself."""

    turns: list[Array]  # (4, 4) each, some way apart from each other
    axis: Array | None  # twist (6,) of a turn by a radian about its axis of revolution, if it has one


def symmetry_of(
    points: NDArray[np.float32], normals: NDArray[np.float32], spacing: float, rolls: int
) -> Symmetry:
    """The turns that map a surface onto itself, one after the other, too.

    Arguments as of :func:`turns_onto_itself`, and ``rolls``, the turns about an axis of revolution.
    """
    axis: Array | None = None
    begun: list[Array] = []

    def meets(T: Array) -> bool:
        return meeting_share(points, normals, spacing, T) >= SHARE

    for order, turn, share in turns_onto_itself(points, normals, spacing):
        if share < SHARE:
            continue
        begun += [np.linalg.matrix_power(turn, k) for k in range(1, order)]
        if axis is None and order > 2:
            rolled = [exp_se3(2 * np.pi * k / rolls * _twist(turn)) for k in range(1, rolls)]
            if all(meets(T) for T in rolled):
                axis, begun = _twist(turn), [*rolled, *begun]
    turns = [np.eye(4)]
    for turn in (*begun, *(compose(a, b) for a in begun for b in begun)):
        apart = min(rotation_angle(turn[:3, :3] @ T[:3, :3].T) for T in turns)
        if apart > np.pi / rolls and meets(turn):
            turns.append(turn)
    return Symmetry(turns[1:], axis)


def _twist(turn: Array) -> Array:
    """The turn (4, 4) about the same axis by a radian, as a twist (6,)."""
    spin = log_so3(turn[:3, :3])
    axis = spin / np.linalg.norm(spin)
    centre = np.linalg.pinv(np.eye(3) - turn[:3, :3], 1e-6) @ turn[:3, 3]
    return np.concatenate([axis, np.cross(centre, axis)])


def principal_turns(points: NDArray[np.float32], rolls: int = 4) -> Iterator[Array]:
    """Turns (4, 4) about the principal axes after which most bodies look alike.

    Half and quarter turns, but so many parts of one about the axis whose two others are the most equal: that
    of a body of revolution.
    """
    centre = points.mean(axis=0).astype(np.float64)
    spread, axes = np.linalg.eigh(np.cov(points.T.astype(np.float64)))
    roundest = 2 if spread[1] * spread[1] < spread[0] * spread[2] else 0
    for k, axis in enumerate(axes.T):
        parts = rolls if k == roundest else 4
        for part in range(1, parts):
            R = exp_so3(2 * np.pi * part / parts * axis)
            yield transform(R, centre - R @ centre)


def _meeting(
    turned: Array, points: Array, normals: Array, tree: 'scipy.spatial.cKDTree', spacing: float
) -> float:
    """Share of moved points (n, 3) that lie on the surface."""
    apart, k = tree.query(turned, distance_upper_bound=NEAR * spacing)
    near = np.isfinite(apart)
    level = np.abs(((turned[near] - points[k[near]]) * normals[k[near]]).sum(axis=1))
    return float((level < SAME * spacing).sum() / len(turned))
