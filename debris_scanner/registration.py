"""Projective registration of two views of the target: point-to-plane, with silhouette evidence.

Points of one view are projected into the other's organised image: no neighbour search, and the
image also tells what a point-only method cannot see: points in front of the surface lie in space
the other view saw to be free, and points beside its mask contradict its silhouette.

Poses are T_target_view; a perturbation is a twist in the target frame applied on the left, so that
one linearisation serves registration, the motion filter and the Lu-Milios network alike.
"""

from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array, compose, exp_se3

Image = NDArray[np.float32]

SAMPLE_STRIDE = 3  # pixels between the points that are registered
MIN_INCIDENCE_COS = 0.2  # surfaces seen more obliquely are not sampled
MIN_FACING_COS = 0.15  # nor expected to be seen by the other view
NORMAL_COS = 0.8  # matched surfaces face the same way
HUBER = 0.003  # m, residuals beyond it count linearly
SILHOUETTE_WEIGHT = 0.1  # of a silhouette point against a surface point; 1.0 biases the pose
MASK_TOLERANCE_PX = 2.0
CONTRADICTION = 0.012  # m: this far beside the mask or in free space is a contradiction


@dataclass
class Surface:
    """Points (n, 3) and unit normals (n, 3), float32, of a view or a model, in its own frame.

    ``anchors`` are the same points with less noise, where there are such: they are projected and serve as
    lever arms. Were it the measured points, their noise would enter both the residual and, by the pixel
    looked up and the lever arm, its derivative; every estimated rotation would come out some per cent
    short. ``rim`` holds the points that must project inside another
    view's silhouette: a view's own rim, any point of a model.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    anchors: NDArray[np.float32]
    rim: NDArray[np.float32]


class View(Surface):
    """A target frame prepared for registration: sampled surface, maps, and silhouette distance field."""

    def __init__(self, frame: TargetFrame) -> None:
        camera = frame.camera
        self.frame = frame
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.depth_fit = frame.depth_fit
        self.normal_map = frame.normals
        step = slice(None, None, SAMPLE_STRIDE)
        z = frame.depth[step, step]
        normals = frame.normals[step, step]
        v, u = np.nonzero((z > 0) & (frame.depth_fit[step, step] > 0))
        points = _back_project(v * SAMPLE_STRIDE, u * SAMPLE_STRIDE, z[v, u], self.intrinsics)
        n = normals[v, u]
        incidence = -(n * points).sum(axis=1) / np.linalg.norm(points, axis=1)
        keep = incidence > MIN_INCIDENCE_COS
        anchors = points * (frame.depth_fit[step, step][v, u] / z[v, u])[:, None]
        mask = frame.depth > 0
        closed = ndimage.binary_closing(mask, np.ones((3, 3), bool), 2)
        distance, nearest = ndimage.distance_transform_edt(~closed, return_indices=True)
        self.mask_distance = distance.astype(np.float32)  # px to the silhouette, 0 inside
        rows, columns = np.indices(mask.shape, dtype=np.float32)
        away = np.stack([columns - nearest[1], rows - nearest[0]], axis=-1)
        self.mask_gradient = (away / np.maximum(distance, 1e-6)[..., None]).astype(np.float32)
        v, u = np.nonzero(mask & ~ndimage.binary_erosion(closed, np.ones((3, 3), bool)))
        rim = _back_project(v[::2], u[::2], frame.depth[v[::2], u[::2]], self.intrinsics)
        super().__init__(points[keep], np.ascontiguousarray(n[keep]), anchors[keep], rim)

    @property
    def centroid(self) -> Array:
        """Mean of the sampled points (3,), view frame, metres."""
        return np.asarray(self.points.mean(axis=0), dtype=np.float64)


def _back_project(
    v: NDArray[np.intp], u: NDArray[np.intp], z: NDArray[np.float32], intrinsics: Array
) -> NDArray[np.float32]:
    fx, fy, cx, cy = intrinsics
    return np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1).astype(np.float32)


@dataclass
class Agreement:
    """How the points of one view agree with the image of another, in counts and sums."""

    points: float = 0.0  # projected
    matched: float = 0.0
    weighted_square: float = 0.0  # m², sum over the matched
    square: float = 0.0  # m², unweighted
    visible: float = 0.0  # projected onto a fitted surface
    in_free_space: float = 0.0
    occluded: float = 0.0
    outside_mask: float = 0.0
    turned_away: float = 0.0  # matched in place but not in normal
    hidden: float = 0.0  # of the visible: behind what is seen there

    def __add__(self, other: 'Agreement') -> 'Agreement':
        return Agreement(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def overlap(self) -> float:
        """Share of the points that should be seen and do match."""
        return self.matched / max(1.0, self.points - self.occluded)

    @property
    def explained(self) -> float:
        """Share of a model's points in view that match.

        What falls into the image's holes is no evidence, nor what the target itself hides: of the
        shuttle stack that is a third of the points that face the sensor.
        """
        return self.matched / max(1.0, self.visible - self.hidden + self.outside_mask)

    @property
    def rms(self) -> float:
        """Root mean square point-to-plane distance of the matched points, metres."""
        return float(np.sqrt(self.square / max(1.0, self.matched)))

    @property
    def free_space(self) -> float:
        """Share of the visible points that contradict free space or face another way."""
        return (self.in_free_space + 0.5 * self.turned_away) / max(1.0, self.visible)

    @property
    def outside(self) -> float:
        """Share of the points beside the other view's silhouette."""
        return self.outside_mask / max(1.0, self.points)


@dataclass
class Linearisation:
    """Normal equations (6, 6) and (6,) of the cost for a twist of the source, in the target frame."""

    H: Array
    g: Array
    agreement: Agreement


def linearise(
    source: Surface, T_target_source: Array, reference: View, T_target_reference: Array, gate: float
) -> Linearisation:
    """Cost of the source's points against the reference view's image, linearised at the given poses.

    Args:
        source: a view or a model's surface.
        T_target_source: (4, 4).
        reference: the view projected into.
        T_target_reference: (4, 4).
        gate: largest point-to-plane distance of a match, metres.
    """
    H, g, counts = np.zeros((6, 6)), np.zeros(6), np.zeros(10)
    R_i, t_i = np.ascontiguousarray(T_target_source[:3, :3]), np.ascontiguousarray(T_target_source[:3, 3])
    R_j = np.ascontiguousarray(T_target_reference[:3, :3])
    t_j = np.ascontiguousarray(T_target_reference[:3, 3])
    _accumulate_surface(
        source.points, source.normals, source.anchors, R_i, t_i, R_j, t_j,
        reference.depth_fit, reference.normal_map, reference.mask_distance, reference.intrinsics,
        gate, H, g, counts,
    )  # fmt: skip
    _accumulate_rim(
        source.rim, R_i, t_i, R_j, t_j, reference.mask_distance, reference.mask_gradient,
        reference.intrinsics, gate, H, g,
    )  # fmt: skip
    H += np.triu(H, 1).T
    return Linearisation(H, g, Agreement(*counts))


def linearise_pair(a: View, T_target_a: Array, b: View, T_target_b: Array, gate: float) -> Linearisation:
    """Both directions of :func:`linearise`, for a twist of a (the negative twist of b)."""
    ab = linearise(a, T_target_a, b, T_target_b, gate)
    ba = linearise(b, T_target_b, a, T_target_a, gate)
    return Linearisation(ab.H + ba.H, ab.g - ba.g, ab.agreement + ba.agreement)


COARSE_TO_FINE = (0.03, 0.02, 0.012, 0.012, 0.008, 0.008, 0.008, 0.008)
MAX_STEP = 0.15  # rad, of one Gauss-Newton step
MIN_MATCHES = 50


def register(
    view: View,
    T_target_view: Array,
    reference: View,
    T_target_reference: Array,
    gates: tuple[float, ...] = COARSE_TO_FINE,
) -> tuple[Array, Linearisation] | None:
    """Register a view to one fixed view by Gauss-Newton over shrinking gates.

    Returns:
        T_target_view (4, 4) and the linearisation there, or None when they do not overlap.
    """
    T = T_target_view
    for k, gate in enumerate(gates):
        lin = linearise_pair(view, T, reference, T_target_reference, gate)
        if lin.agreement.matched < MIN_MATCHES:
            return None
        step = solve_step(lin.H, lin.g)
        T = compose(exp_se3(step), T)
        if k == len(gates) - 1 or (
            gate == gates[-1] and np.abs(step[:3]).max() < 2e-4 and np.abs(step[3:]).max() < 5e-5
        ):
            break
    return T, linearise_pair(view, T, reference, T_target_reference, gates[-1])


def solve_step(H: Array, g: Array) -> Array:
    """Gauss-Newton step (6,), lightly damped and with its rotation bounded."""
    damped = H + np.eye(6) * (1e-6 * np.trace(H) / 6 + 1e-12)
    step = np.asarray(-np.linalg.solve(damped, g), np.float64)
    angle = float(np.linalg.norm(step[:3]))
    return step * (MAX_STEP / angle) if angle > MAX_STEP else step


@njit(cache=True, fastmath=True, nogil=True)
def _accumulate_surface(
    points: Image, normals: Image, anchors: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    depth: Image, normal_map: Image, mask_distance: Image, intrinsics: Array,
    gate: float, H: Array, g: Array, counts: Array,
) -> None:  # fmt: skip
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    J = np.empty(6)
    counts[0] += points.shape[0]
    for k in range(points.shape[0]):
        p0, p1, p2 = anchors[k, 0], anchors[k, 1], anchors[k, 2]
        X0 = R_i[0, 0] * p0 + R_i[0, 1] * p1 + R_i[0, 2] * p2 + t_i[0]
        X1 = R_i[1, 0] * p0 + R_i[1, 1] * p1 + R_i[1, 2] * p2 + t_i[1]
        X2 = R_i[2, 0] * p0 + R_i[2, 1] * p1 + R_i[2, 2] * p2 + t_i[2]
        d0, d1, d2 = X0 - t_j[0], X1 - t_j[1], X2 - t_j[2]
        y0 = R_j[0, 0] * d0 + R_j[1, 0] * d1 + R_j[2, 0] * d2
        y1 = R_j[0, 1] * d0 + R_j[1, 1] * d1 + R_j[2, 1] * d2
        y2 = R_j[0, 2] * d0 + R_j[1, 2] * d1 + R_j[2, 2] * d2
        if y2 < 0.1:
            continue
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        b0 = R_i[0, 0] * n0 + R_i[0, 1] * n1 + R_i[0, 2] * n2
        b1 = R_i[1, 0] * n0 + R_i[1, 1] * n1 + R_i[1, 2] * n2
        b2 = R_i[2, 0] * n0 + R_i[2, 1] * n1 + R_i[2, 2] * n2
        m0 = R_j[0, 0] * b0 + R_j[1, 0] * b1 + R_j[2, 0] * b2
        m1 = R_j[0, 1] * b0 + R_j[1, 1] * b1 + R_j[2, 1] * b2
        m2 = R_j[0, 2] * b0 + R_j[1, 2] * b1 + R_j[2, 2] * b2
        facing = -(m0 * y0 + m1 * y1 + m2 * y2) / (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5
        u = int(np.floor(y0 / y2 * fx + cx + 0.5))
        v = int(np.floor(y1 / y2 * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            counts[7] += 1
            continue
        beside = mask_distance[v, u] - MASK_TOLERANCE_PX
        if beside > 0:
            if beside * y2 / fx > CONTRADICTION:
                counts[7] += 1
            continue
        if facing < MIN_FACING_COS:
            counts[6] += 1  # it may hide behind the target itself: no statement
            continue
        d = depth[v, u]
        if d <= 0:
            continue
        counts[4] += 1
        dz = y2 - d
        if dz < -CONTRADICTION and dz < -gate:
            counts[5] += 1
            continue
        q0, q1, q2 = normal_map[v, u, 0], normal_map[v, u, 1], normal_map[v, u, 2]
        # the measured point lies as far beside its anchor as the two differ in their own frame
        e0, e1, e2 = points[k, 0] - p0, points[k, 1] - p1, points[k, 2] - p2
        f0 = R_i[0, 0] * e0 + R_i[0, 1] * e1 + R_i[0, 2] * e2
        f1 = R_i[1, 0] * e0 + R_i[1, 1] * e1 + R_i[1, 2] * e2
        f2 = R_i[2, 0] * e0 + R_i[2, 1] * e1 + R_i[2, 2] * e2
        c0 = R_j[0, 0] * q0 + R_j[0, 1] * q1 + R_j[0, 2] * q2
        c1 = R_j[1, 0] * q0 + R_j[1, 1] * q1 + R_j[1, 2] * q2
        c2 = R_j[2, 0] * q0 + R_j[2, 1] * q1 + R_j[2, 2] * q2
        # the foot is on the pixel's own ray: half a pixel of rounding would bias oblique surfaces
        r = q0 * (y0 - (u - cx) / fx * d) + q1 * (y1 - (v - cy) / fy * d) + q2 * dz
        r += c0 * f0 + c1 * f1 + c2 * f2
        if abs(r) > gate or abs(dz) > 4 * gate:
            if dz > 0:
                counts[6] += 1
                counts[9] += 1
            else:
                counts[5] += 1
            continue
        if q0 * m0 + q1 * m1 + q2 * m2 < NORMAL_COS:
            counts[8] += 1
            continue
        weight = 1.0 if abs(r) < HUBER else HUBER / abs(r)
        weight *= max(facing, 0.3)
        J[0], J[1], J[2] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2, X0 * c1 - X1 * c0
        J[3], J[4], J[5] = c0, c1, c2
        counts[1] += 1
        counts[2] += weight * r * r
        counts[3] += r * r
        for a in range(6):
            g[a] += weight * J[a] * r
            for b in range(a, 6):
                H[a, b] += weight * J[a] * J[b]


@njit(cache=True, fastmath=True, nogil=True)
def _accumulate_rim(
    rim: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array, mask_distance: Image, mask_gradient: Image,
    intrinsics: Array, gate: float, H: Array, g: Array,
) -> None:  # fmt: skip
    """Every surface point must project inside the other mask (visual hull); its rim is what can fail."""
    fx, fy, cx, cy = intrinsics
    h, w = mask_distance.shape
    J = np.empty(6)
    for k in range(rim.shape[0]):
        p0, p1, p2 = rim[k, 0], rim[k, 1], rim[k, 2]
        X0 = R_i[0, 0] * p0 + R_i[0, 1] * p1 + R_i[0, 2] * p2 + t_i[0]
        X1 = R_i[1, 0] * p0 + R_i[1, 1] * p1 + R_i[1, 2] * p2 + t_i[1]
        X2 = R_i[2, 0] * p0 + R_i[2, 1] * p1 + R_i[2, 2] * p2 + t_i[2]
        d0, d1, d2 = X0 - t_j[0], X1 - t_j[1], X2 - t_j[2]
        y0 = R_j[0, 0] * d0 + R_j[1, 0] * d1 + R_j[2, 0] * d2
        y1 = R_j[0, 1] * d0 + R_j[1, 1] * d1 + R_j[2, 1] * d2
        y2 = R_j[0, 2] * d0 + R_j[1, 2] * d1 + R_j[2, 2] * d2
        if y2 < 0.1:
            continue
        u = int(np.floor(y0 / y2 * fx + cx + 0.5))
        v = int(np.floor(y1 / y2 * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h or mask_distance[v, u] <= 0:
            continue
        r = (mask_distance[v, u] - 0.5) * y2 / fx
        if r > 2 * gate:
            continue
        gx, gy = mask_gradient[v, u, 0], mask_gradient[v, u, 1]
        weight = SILHOUETTE_WEIGHT * (1.0 if r < HUBER else HUBER / r)
        gz = -(gx * y0 + gy * y1) / y2
        c0 = R_j[0, 0] * gx + R_j[0, 1] * gy + R_j[0, 2] * gz
        c1 = R_j[1, 0] * gx + R_j[1, 1] * gy + R_j[1, 2] * gz
        c2 = R_j[2, 0] * gx + R_j[2, 1] * gy + R_j[2, 2] * gz
        J[0], J[1], J[2] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2, X0 * c1 - X1 * c0
        J[3], J[4], J[5] = c0, c1, c2
        for a in range(6):
            g[a] += weight * J[a] * r
            for b in range(a, 6):
                H[a, b] += weight * J[a] * J[b]
