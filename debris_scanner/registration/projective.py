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

"""Projective registration of two views of the target: point-to-plane, with silhouette evidence.

Points of one view are projected into the other's organised image: no neighbour search. The image also
gives evidence that a point-only method lacks. Points in front of the surface violate free space, and points
beside its mask violate its silhouette.

Poses are T_target_view. A perturbation is a twist in the target frame, applied on the left, so that
one linearisation serves registration, the motion filter and the Lu-Milios network alike.

The normal matrix also shows whether the target's rotation can be observed: a body of revolution turns without
changing its image.
"""

import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from debris_scanner.core.geometry import Array, apply, compose, exp_se3, parts
from debris_scanner.core.optional import kernel
from debris_scanner.registration.kernels import accumulate_pairs, accumulate_rim, accumulate_surface
from debris_scanner.registration.picture_terms import PictureTerms, reconcile
from debris_scanner.registration.view_table import ViewTable, both_directions
from debris_scanner.sensing.views import Surface, View

LEAST_MEASURED = 0.2  # share of the points that a porous view must show to agree at all
COARSE_TO_FINE = (20.0, 13.0, 8.0, 8.0, 5.5, 5.5, 5.5, 5.5)  # px: gates of the iterations
CONVERGED = 2e-4  # rad, of a step
CONVERGED_PX = 0.035
MAX_STEP = 0.15  # rad, of one Gauss-Newton step
MIN_MATCHES = 50
OBSERVABLE = 0.001  # information a matched point; with less, a face may slide along another at equal cost
_ABOVE_DIAGONAL = np.triu(np.ones((6, 6)), 1)
MIN_OVERLAP = 0.5  # of two views that show the same side: most of what one shows the other shows too


@dataclass
class RegistrationStats:
    """How the points of one view agree with the image of another, in counts and sums."""

    points: float = 0.0  # projected
    matched: float = 0.0
    square: float = 0.0  # px², sum over the matched, of points beyond the usual range referred to there
    visible: float = 0.0  # projected onto a fitted surface
    in_free_space: float = 0.0
    occluded: float = 0.0
    outside_mask: float = 0.0
    turned_away: float = 0.0  # matched in place but not in normal
    hidden: float = 0.0  # of the visible: behind what is seen there

    def __add__(self, other: 'RegistrationStats') -> 'RegistrationStats':
        return RegistrationStats(
            self.points + other.points,
            self.matched + other.matched,
            self.square + other.square,
            self.visible + other.visible,
            self.in_free_space + other.in_free_space,
            self.occluded + other.occluded,
            self.outside_mask + other.outside_mask,
            self.turned_away + other.turned_away,
            self.hidden + other.hidden,
        )

    def within_silhouette(self) -> 'RegistrationStats':
        """Without silhouette violations, where they are no evidence."""
        return replace(self, points=self.points - self.outside_mask, outside_mask=0.0)

    def where_measured(self) -> 'RegistrationStats':
        """Without points that no pixel measured, unless few were measured: those would prove little."""
        if self.matched < LEAST_MEASURED * (self.points - self.occluded):
            return replace(self, outside_mask=0.0)
        return replace(self, points=self.visible - self.hidden + self.occluded, outside_mask=0.0)

    @property
    def overlap(self) -> float:
        """Share of the points that should be seen and do match."""
        return self.matched / max(1.0, self.points - self.occluded)

    @property
    def visible_inlier_ratio(self) -> float:
        """Share of a model's points in view that match.

        Points in the image's holes are no evidence, nor points that the target itself occludes: of the
        shuttle stack a third of the points that face the sensor.
        """
        return self.matched / max(1.0, self.visible - self.hidden + self.outside_mask)

    @property
    def rms(self) -> float:
        """Root mean square point-to-plane distance of the matched points, px of the reference."""
        return float(np.sqrt(self.square / max(1.0, self.matched)))

    @property
    def conflict_ratio(self) -> float:
        """Share of the visible points that violate free space or face another way."""
        return (self.in_free_space + 0.5 * self.turned_away) / max(1.0, self.visible)

    @property
    def silhouette_violation_ratio(self) -> float:
        """Share of the points beside the other view's silhouette."""
        return self.outside_mask / max(1.0, self.points)


@dataclass
class Linearisation:
    """Normal equations (6, 6) and (6,) of the cost for a twist of the source, in the target frame."""

    H: Array
    g: Array
    stats: RegistrationStats


def linearise(
    source: Surface,
    T_target_source: Array,
    reference: View,
    T_target_reference: Array,
    gate: float,
    step: int = 1,
) -> Linearisation:
    """Cost of the source's points against the reference view's image, linearised at the given poses.

    Args:
        source: a view or a model's surface.
        T_target_source: (4, 4).
        reference: the view projected into.
        T_target_reference: (4, 4).
        gate: largest point-to-plane distance of a match, in multiples of the reference's resolution (px).
        step: every step-th point stands for so many; the counts are those of the points looked at.
    """
    resolution = reference.resolution
    gate *= resolution
    usual_range = reference.footprint * reference.frame.camera.focal
    H, g, counts = np.zeros((6, 6)), np.zeros(6), np.zeros(9)
    R_i, t_i = parts(T_target_source)
    R_j, t_j = parts(T_target_reference)
    accumulate_surface(
        source.points, source.normals, source.anchors, R_i, t_i, R_j, t_j,
        reference.depth_map, reference.normal_map, reference.beside, reference.open_sides,
        reference.intrinsics, resolution, usual_range, gate, source.shared_noise, step, H, g, counts,
    )  # fmt: skip
    H /= source.density
    g /= source.density
    stats, hull = _stats(counts, reference), _rim_compared(source, reference)
    if hull >= 0:
        rim = source.rim
        accumulate_rim(
            rim.points, rim.normals, rim.edge, R_i, t_i, R_j, t_j,
            reference.beside, reference.edges.index, reference.edges.outward, reference.depth_map,
            reference.normal_map, reference.intrinsics, resolution, gate, hull > 0, step, H, g,
        )  # fmt: skip
    H = mirrored(H)
    return Linearisation(step * H, step * g, stats)


def _stats(counts: Iterable[float], reference: View) -> RegistrationStats:
    """From the counts (9,) of the kernel."""
    stats = RegistrationStats(*counts)
    return stats.where_measured() if reference.porous else stats


def _rim_compared(source: Surface, reference: View) -> int:
    """What is compared of the source's rim: 1 all of it, 0 its edges alone, -1 nothing."""
    if source.porous or reference.porous or not (source.unoccluded or reference.unoccluded):
        return -1
    return int(reference.unoccluded)


def mirrored(H: Array) -> Array:
    """A symmetric matrix (6, 6) of its upper triangle; the lower one is 0."""
    return H + (H * _ABOVE_DIAGONAL).T


def linearise_shapes(
    a: View, T_target_a: Array, b: View, T_target_b: Array, gate: float, step: int = 1
) -> Linearisation:
    """Both directions of :func:`linearise`, for a twist of a (the negative twist of b)."""
    ab = linearise(a, T_target_a, b, T_target_b, gate, step)
    ba = linearise(b, T_target_b, a, T_target_a, gate, step)
    return Linearisation(ab.H + ba.H, ab.g - ba.g, ab.stats + ba.stats)


def linearise_pair(
    a: View, T_target_a: Array, b: View, T_target_b: Array, gate: float, pictures: PictureTerms | None = None
) -> Linearisation:
    """The shapes of two views, and their pictures beside them, for a twist of a.

    Pictures are compared in one direction: they say the same in the other.

    Args:
        a: a view.
        T_target_a: its pose (4, 4).
        b: another view.
        T_target_b: its pose (4, 4).
        gate: see :func:`linearise`.
        pictures: of both, where a moves step by step; None: they are looked at anew.
    """
    pair = linearise_shapes(a, T_target_a, b, T_target_b, gate)
    _add_picture(pair, pictures or PictureTerms(a, b, T_target_b), a, T_target_a, b, gate)
    return pair


def linearise_pairs(
    table: ViewTable,
    poses: Sequence[Array],
    pairs: Sequence[tuple[int, int]],
    gate: float,
    pictures: bool = True,
) -> list[Linearisation]:
    """:func:`linearise_pair` of many pairs at once.

    Args:
        table: of the views.
        poses: T_target_view (4, 4) of each.
        pairs: two views each, by index.
        gate: see :func:`linearise`.
        pictures: whether they are compared, too.
    """
    m, (directions, order) = len(pairs), both_directions(pairs)
    H, g, counts = np.zeros((2 * m, 6, 6)), np.zeros((2 * m, 6)), np.zeros((2 * m, 9))
    views = table.views
    of_views = [(v.density, v.shared_noise) for v in views]
    scales = np.column_stack([table.resolution, table.usual_range, np.array(of_views, float)])
    hulls = np.array([_rim_compared(views[i], views[j]) for i, j in directions.tolist()], np.int8)
    accumulate_pairs(
        table.addresses, table.sizes, table.intrinsics, scales, hulls, np.array(poses), directions, order,
        gate, H, g, counts,
    )  # fmt: skip
    g[:m] *= -1  # a twist of the second view is one of the first the other way
    stats = [_stats(of, views[j]) for of, j in zip(counts.tolist(), directions[:, 1].tolist(), strict=True)]
    found = [Linearisation(H[n] + H[m + n], g[n] + g[m + n], stats[m + n] + stats[n]) for n in range(m)]
    for (i, j), pair in zip(pairs, found, strict=True):
        if pictures and views[i].picture is not None:
            _add_picture(pair, PictureTerms(views[i], views[j], poses[j]), views[i], poses[i], views[j], gate)
    return found


def _add_picture(
    pair: Linearisation, pictures: PictureTerms, a: View, T_target_a: Array, b: View, gate: float
) -> None:
    """Add what the pictures of two views say, where both have any."""
    shown = pictures.at(T_target_a, gate)
    if shown is not None and pair.stats.matched > 0:
        variance = (pair.stats.rms * b.resolution) ** 2
        weigh_picture(pair.H, pair.g, shown[0], shown[1], variance, a, T_target_a, pair.stats.matched)


def weigh_picture(
    H: Array, g: Array, H_picture: Array, g_picture: Array, variance: float, view: View, T_target_view: Array,
    matched: float,
) -> None:  # fmt: skip
    """Add what a view's picture says of its pose to what so many matched points of its shape say.

    See :func:`reconcile`, also for the arguments. Where the two cannot be told apart, the shape alone counts.
    """
    centre = apply(T_target_view, view.centroid)
    least = OBSERVABLE * matched / view.density
    with contextlib.suppress(np.linalg.LinAlgError):  # before anything is added
        reconcile(H, g, H_picture, g_picture, variance, centre, view.gyration_square, least)


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
    T, pictures = T_target_view, PictureTerms(view, reference, T_target_reference)
    for k, gate in enumerate(gates):
        lin = linearise_pair(view, T, reference, T_target_reference, gate, pictures)
        if lin.stats.matched < MIN_MATCHES or not np.isfinite(lin.H).all():
            return None
        step = solve_step(lin.H, lin.g)
        T = compose(exp_se3(step), T)
        if k == len(gates) - 1 or (
            gate == gates[-1]
            and np.abs(step[:3]).max() < CONVERGED
            and np.abs(step[3:]).max() < CONVERGED_PX * reference.footprint
        ):
            break
    return T, linearise_pair(view, T, reference, T_target_reference, gates[-1], pictures)


def solve_step(H: Array, g: Array) -> Array:
    """Gauss-Newton step (6,), lightly damped, its rotation bounded; zeros without a finite solution."""
    damped = H + np.eye(6) * (1e-6 * np.trace(H) / 6 + 1e-12)
    try:
        step = np.asarray(-np.linalg.solve(damped, g), np.float64)
    except np.linalg.LinAlgError:
        return np.zeros(6)
    if not np.isfinite(step).all():
        return np.zeros(6)
    angle = float(np.linalg.norm(step[:3]))
    return step * (MAX_STEP / angle) if angle > MAX_STEP else step


def rotation_observability(H: Array, matched: float, view: View, T_target_view: Array) -> float:
    """Smallest rotation information per matched point, relative to the target's size squared.

    The registration's normal matrix is moved to the view's centroid, its translation marginalised, and
    the smallest eigenvalue is divided by n r². A cylinder about its axis stays near 0.0005; a target whose
    rotation shows lies above 0.002.

    Args:
        H: normal matrix (6, 6) for a twist in the target frame.
        matched: number of matched points behind it.
        view: the registered view.
        T_target_view: (4, 4).
    """
    rotation, _ = marginal_rotation(H, apply(T_target_view, view.centroid))
    return float(np.linalg.eigvalsh(rotation)[0] / (max(matched, 1.0) * view.gyration_square))


@kernel()
def marginal_rotation(H: Array, centre: Array) -> tuple[Array, Array]:
    """Information (3, 3) on a rotation about a centre, and the best shift (3, 3) of the centre per turn.

    Args:
        H: normal matrix (6, 6) for a twist in the target frame; its translation is marginalised.
        centre: (3,), target frame.
    """
    A = np.eye(6)
    A[3, 1], A[3, 2], A[4, 2] = -centre[2], centre[1], -centre[0]
    A[4, 0], A[5, 0], A[5, 1] = centre[2], -centre[1], centre[0]
    Hc = A.T @ H @ A
    across = np.ascontiguousarray(Hc[3:, :3])
    shift = -np.linalg.pinv(np.ascontiguousarray(Hc[3:, 3:]), 1e-6) @ across
    return Hc[:3, :3] + across.T @ shift, shift
