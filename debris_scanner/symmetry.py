"""Rotational symmetry of a model: turned by a full turn over n about a principal axis, is it the same?

An attitude of such a target is known up to its symmetry only; which of its equals is meant, continuity tells.
"""

import numpy as np
from scipy.spatial import cKDTree

from debris_scanner.geometry import Array, exp_so3, project_so3, rotation_angle
from debris_scanner.model import Model

ORDERS = (12, 8, 6, 5, 4, 3, 2)  # tried in this order; a body of revolution passes the first
POINTS = 2000
SAME = 0.002  # m between surfaces that are the same
NEAR = 0.012  # m: further from any point there is no surface
SHARE = 0.98  # of the points that must find the surface again
ITERATIONS = 8
FITTED = np.radians(5.0)  # the principal axes are known to this


def rotational_symmetry(model: Model) -> int | None:
    """The highest order n of a rotation about a principal axis that maps the model onto itself, or None."""
    points = model.points.astype(np.float64)
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    tree = cKDTree(centred)
    rng = np.random.default_rng(0)
    drawn = centred[rng.choice(len(centred), min(POINTS, len(centred)), replace=False)]
    normals = model.normals.astype(np.float64)
    for n in ORDERS:
        if any(_maps_onto_itself(drawn, centred, normals, tree, exp_so3(2 * np.pi / n * a)) for a in axes.T):
            return n
    return None


def _maps_onto_itself(drawn: Array, points: Array, normals: Array, tree: cKDTree, R: Array) -> bool:
    """Whether the surface meets itself once turned by about R, moved a little to fit (point to plane)."""
    t, about = np.zeros(3), R
    for _ in range(ITERATIONS):
        turned = drawn @ R.T + t
        apart, k = tree.query(turned)
        near = apart < NEAR
        if near.mean() < 0.5:
            return False
        x, n = turned[near], normals[k[near]]
        J = np.concatenate([np.cross(x, n), n], axis=1)
        r = ((x - points[k[near]]) * n).sum(axis=1)
        step = -np.linalg.lstsq(J, r, rcond=1e-6)[0]
        turn = exp_so3(step[:3])
        R, t = project_so3(turn @ R), turn @ t + step[3:]
    if rotation_angle(R @ about.T) > FITTED:
        return False  # it slid into another attitude, or back
    turned = drawn @ R.T + t
    apart, k = tree.query(turned)
    level = np.abs(((turned - points[k]) * normals[k]).sum(axis=1))
    return bool(((apart < NEAR) & (level < SAME)).mean() >= SHARE)
