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

"""Likelihood of one view given another: the beam model of a depth sensor (Thrun, Burgard, Fox 2005, ch. 6).

A pixel that looks at a known surface returns that surface with the sensor's noise (hit), something nearer
(short) or farther (long), or nothing (none). The noise is the one measured on the stream; the four shares are
estimated from neighbouring views, apart for surfaces that face the sensor and for oblique ones:

    log p(z) = log( share_hit N(z - z_expected; sigma²) + share_short_or_long / extent ),  log share_none

Unlike a sum of squares inside a gate it can be compared between poses that match more or fewer points, and
between sensors: its unit is the nat a point.
"""

import statistics
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.core.optional import kernel
from debris_scanner.registration.picture_terms import picture_terms
from debris_scanner.registration.projective import COARSE_TO_FINE
from debris_scanner.registration.view_table import (
    ANCHORS,
    DEPTH,
    DEPTH_MAP,
    HEIGHT,
    NORMALS,
    POINT_COUNT,
    POINTS,
    WIDTH,
    Addresses,
    ViewTable,
    both_directions,
    image,
    normal_image,
    open_sides,
    steps,
    vectors,
)
from debris_scanner.sensing.sensor_model import SensorModel, typical_sensor
from debris_scanner.sensing.silhouette import Mask, Steps, distance, unseen
from debris_scanner.sensing.views import FACING_COS, Surface, View

HIT, SHORT, LONG, NONE = range(4)
# where a point falls in the other image: on surface or before it, behind surface, beside the silhouette, or
# where nothing is to be said: in a hole, at the silhouette's edge
MET, BEHIND, OUTSIDE, UNKNOWN = range(4)
BESIDE_PX = 10.0  # of the silhouette's edge, times the resolution in pixels
STORED = float(np.finfo(np.float32).eps)  # of a depth, that its format resolves: no sensor is better
ENOUGH = 500  # points of a surface: their mean is as good as that of all
FEWEST_MET = 50  # points of both views
REMEMBERED = 100  # losses, whose median is the usual one
FEW = 5  # of them, from which on it is known
UNKNOWN_LOSS = 1.5  # nats, taken for the usual loss before: that of sensors so far is 0.1 to 0.9
FACING, OBLIQUE = range(2)
MATCH_PX = COARSE_TO_FINE[-1]  # of the resolution: colours are compared of points this near to the surface
FINE = 2.0  # factor on the noise; with a larger one the coarse pictures are compared
MIN_COS = 0.34  # 70 degrees: more oblique surfaces are not predicted
SAME_NORMAL_COS = 0.5  # a point hits a surface only if both face the same way
OUTLIER_DEPTH = 0.6  # of the target's extent: what is no hit lies anywhere in it
POINT_VARIANCE = 1.4  # of a fitted point against a measured pixel, in variances of a pixel
FACING_TAN, OBLIQUE_TAN = 0.62, 1.64  # typical incidence of the two classes that the noise is measured on

Image = NDArray[np.float32]


@dataclass(frozen=True)
class BeamModel:
    """What a pixel returns of a surface that another view saw."""

    sigma: (
        float  # m, of a pixel's depth on a facing surface at ``range_m``; grows with the square of the range
    )
    slope_sigma: float  # m, added for each unit of the tangent of the incidence
    range_m: float
    extent: float  # m, what is no hit is even over it
    shares: Array  # (2, 4): facing and oblique; hit, short, long, none

    @staticmethod
    def of(sensor: SensorModel, views: Sequence[View]) -> 'BeamModel':
        """From what was measured on a stream, for the target in some views."""
        least = STORED * sensor.range_m
        extent = max(float(np.median([np.linalg.norm(np.ptp(v.points, axis=0)) for v in views])), least)
        facing = max(sensor.sigma_m, least)
        oblique = sensor.sigma_oblique_m or 1.2 * facing
        excess = max(oblique**2 - facing**2, (0.1 * facing) ** 2)
        slope = float(np.sqrt(excess / (OBLIQUE_TAN**2 - FACING_TAN**2)))
        level = max(facing**2 - (slope * FACING_TAN) ** 2, (0.5 * facing) ** 2)
        return BeamModel(
            float(np.sqrt(level)), slope, sensor.range_m, OUTLIER_DEPTH * extent, np.array(sensor.shares)
        )

    @property
    def best(self) -> float:
        """Mean log-likelihood, nats a point, of facing surface exactly where it is expected."""
        return float(
            np.log(self.shares[FACING, HIT]) - 0.5 * np.log(2 * np.pi * POINT_VARIANCE * self.sigma**2)
        )

    def with_shares_of(self, pairs: Iterable['PairLikelihood']) -> 'BeamModel':
        """The same with the shares that pairs of views show (one step of expectation maximisation)."""
        counts = sum((pair.counts for pair in pairs), np.ones((2, 4)))
        return replace(self, shares=counts / counts.sum(axis=1, keepdims=True))


@dataclass
class PairLikelihood:
    """Log-likelihood of one or both views of a pair, and its expansion in a twist of the first."""

    H: Array  # (6, 6), information on a twist in the target frame about the centre
    g: Array  # (6,), gradient of the negative log-likelihood
    counts: Array  # (2, 4): expected numbers of hit, short, long, none on facing and oblique surface
    nats: Array  # (4,), log-likelihood of the points met, behind, beside, unknown
    numbers: Array  # (4,), of these points
    picture: float = 0.0  # log-likelihood of the colours, over that of unrelated pictures

    @property
    def log_likelihood(self) -> float:
        """Of all points, nats."""
        return float(self.nats.sum()) + self.picture

    @property
    def points(self) -> float:
        """Number of points that say something."""
        return float(self.counts.sum())


def pair_likelihood(
    a: View, T_target_a: Array, b: View, T_target_b: Array, beam: BeamModel, centre: Array, widen: float = 1.0
) -> PairLikelihood:
    """Both views of a pair given each other, expanded in a left twist of a (of b, with the other sign).

    Args:
        a: a view.
        T_target_a: its pose (4, 4).
        b: the other view.
        T_target_b: its pose (4, 4).
        beam: the sensor's model.
        centre: (3,), target frame: what the twist turns about.
        widen: factor on the noise, to see from further away.
    """
    pair = _nothing()
    if widen != 1:
        beam = replace(beam, sigma=widen * beam.sigma, slope_sigma=widen * beam.slope_sigma)
    _add(pair, b, T_target_b, a, T_target_a, beam, centre)
    pair.g *= -1  # a twist of b is one of a the other way
    _add(pair, a, T_target_a, b, T_target_b, beam, centre)
    _add_picture(pair, a, T_target_a, b, T_target_b, centre, widen)
    return pair


def pair_likelihoods(
    table: ViewTable,
    poses: Sequence[Array],
    pairs: Sequence[tuple[int, int]],
    beam: BeamModel,
    centre: Array,
    widen: float = 1.0,
) -> list[PairLikelihood]:
    """:func:`pair_likelihood` of many pairs at once.

    Args:
        table: of the views.
        poses: T_target_view (4, 4) of each.
        pairs: two views each, by index.
        beam: the sensor's model.
        centre: (3,), target frame: what the twists turn about.
        widen: factor on the noise, to see from further away.
    """
    m, (directions, order) = len(pairs), both_directions(pairs)
    H, g, counts = np.zeros((2 * m, 6, 6)), np.zeros((2 * m, 6)), np.zeros((2 * m, 2, 4))
    nats, numbers = np.zeros((2, 2 * m, 4))
    _accumulate_pairs(
        table.addresses, table.sizes, table.intrinsics, BESIDE_PX * table.resolution / table.footprint,
        np.array(poses), centre, directions, order,
        widen * beam.sigma / beam.range_m**2, widen * beam.slope_sigma, beam.shares, 1.0 / beam.extent,
        H, g, counts, nats, numbers,
    )  # fmt: skip
    g[:m] *= -1  # a twist of the second view is one of the first the other way
    of_both = (of[:m] + of[m:] for of in (H, g, counts, nats, numbers))
    found = [PairLikelihood(*of_pair) for of_pair in zip(*of_both, strict=True)]
    for (i, j), pair in zip(pairs, found, strict=True):
        _add_picture(pair, table.views[i], poses[i], table.views[j], poses[j], centre, widen)
    return found


def typical_beam(view: View) -> BeamModel:
    """What a typical sensor returns in a view, before this one is measured."""
    sensor = typical_sensor([view])
    grain = view.resolution / view.footprint
    return BeamModel.of(replace(sensor, sigma_m=grain * sensor.sigma_m), [view])


def frame_loss(
    view: View, T_view: Array, reference: Surface, T_reference: Array, beam: BeamModel | None = None
) -> tuple[float, float]:
    """How badly a view and a view or model contradict each other, nats a point; inf where they do not meet.

    The loss against surface met exactly, under a typical sensor. What may be hidden is no evidence: surface
    behind what the other shows, holes, and what the view lacks. What the view shows beside the silhouette of
    an unoccluded reference is: all of the target projects into it.

    Args:
        view: a view, perhaps half hidden.
        T_view: its pose (4, 4).
        reference: a view or a model.
        T_reference: its pose (4, 4).
        beam: of the view, if it is at hand.

    Returns:
        the loss, and that of the points inside the reference's silhouette.
    """
    beam = beam or typical_beam(view)
    pair = _nothing()
    _add(pair, reference, T_reference, view, T_view, beam, step=max(1, len(reference.points) // ENOUGH))
    nats, points = pair.nats[MET], pair.numbers[MET]
    beside = np.zeros(2)
    if isinstance(reference, View):
        pair = _nothing()
        _add(pair, view, T_view, reference, T_reference, beam, step=max(1, len(view.points) // ENOUGH))
        nats, points = nats + pair.nats[MET], points + pair.numbers[MET]
        if reference.unoccluded and not reference.porous:
            beside = np.array([pair.nats[OUTSIDE], pair.numbers[OUTSIDE]])
    if points < FEWEST_MET:
        return np.inf, np.inf
    return float(beam.best - (nats + beside[0]) / (points + beside[1])), float(beam.best - nats / points)


def mutual_loss(a: View, T_a: Array, b: View, T_b: Array) -> float:
    """The larger of the two views' losses given each other, posed by T (4, 4), nats a point."""
    return max(frame_loss(a, T_a, b, T_b)[0], frame_loss(b, T_b, a, T_a)[0])


def shared_evidence(a: View, T_a: Array, b: View, T_b: Array) -> tuple[float, float]:
    """Loss of what two views both show, nats of all its points, and the number of these points."""
    beam, pair = typical_beam(a), _nothing()
    for source, T_source, view, T_view in ((b, T_b, a, T_a), (a, T_a, b, T_b)):
        _add(pair, source, T_source, view, T_view, beam, step=max(1, len(source.points) // ENOUGH))
    return float(beam.best * pair.numbers[MET] - pair.nats[MET]), float(pair.numbers[MET])


class UsualLoss:
    """The usual loss of a scan's right poses: it absorbs what differs between sensors and targets."""

    def __init__(self) -> None:
        self._losses: deque[float] = deque(maxlen=REMEMBERED)
        self._usual = UNKNOWN_LOSS

    def add(self, loss: float) -> None:
        """Learn from a pose that is right."""
        if np.isfinite(loss):
            self._losses.append(loss)
            if len(self._losses) >= FEW:
                self._usual = statistics.median(self._losses)

    def excess(self, loss: float) -> float:
        """By how much a loss exceeds the usual one, nats a point; at least, while that is not known."""
        return loss - self._usual

    def rank(self, loss: float) -> float:
        """Share of the usual losses that are smaller; 1 while they are not known."""
        return float(np.mean(np.array(self._losses) < loss)) if len(self._losses) >= FEW else 1.0


def _nothing() -> PairLikelihood:
    return PairLikelihood(np.zeros((6, 6)), np.zeros(6), np.zeros((2, 4)), np.zeros(4), np.zeros(4))


def _add_picture(
    pair: PairLikelihood, a: View, T_a: Array, b: View, T_b: Array, centre: Array, widen: float
) -> None:
    """Add what the colours of two views say, where both have any."""
    gate = MATCH_PX * widen * b.resolution
    shown = picture_terms(a, T_a, b, T_b, gate, centre, coarse=widen > FINE)
    if shown is not None:
        # the other direction says the same of as many points
        pair.H += 2 * shown[0]
        pair.g += 2 * shown[1]
        pair.picture = 2 * shown[2]


def _add(
    pair: PairLikelihood,
    source: Surface,
    T_source: Array,
    reference: View,
    T_reference: Array,
    beam: BeamModel,
    centre: Array | None = None,
    step: int = 1,
) -> None:
    """Add every step-th of the source's points in the image of the reference; H and g about a centre."""
    about = np.zeros(3) if centre is None else centre
    T = inverse(T_reference) @ T_source
    frame = reference.frame
    _accumulate(
        source.points, source.anchors, source.normals,
        np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]),
        np.ascontiguousarray(T_source[:3, :3]), np.ascontiguousarray(T_source[:3, 3] - about),
        np.ascontiguousarray(T_reference[:3, :3]),
        frame.depth, reference.depth_map, frame.normals, reference.beside, reference.open_sides,
        reference.intrinsics,
        BESIDE_PX * reference.resolution / reference.footprint,
        beam.sigma / beam.range_m**2, beam.slope_sigma, beam.shares, 1.0 / beam.extent,
        step, centre is not None, pair.H, pair.g, pair.counts, pair.nats, pair.numbers,
    )  # fmt: skip


@kernel(fastmath=True)
def _accumulate(
    points: Image, anchors: Image, normals: Image,
    R: Array, t: Array, R_source: Array, t_source: Array, R_reference: Array,
    depth: Image, depth_map: Image, normal_map: Image, beside: Steps, sides: Mask, intrinsics: Array,
    margin: float, sigma: float, slope_sigma: float, shares: Array, even: float, step: int, expand: bool,
    H: Array, g: Array, counts: Array, nats: Array, numbers: Array,
) -> None:  # fmt: skip
    """Add one direction of a pair to H, g, counts (2, 4), nats (4,) and numbers (4,).

    H is copied from its upper triangle. R and t carry a point of the source into the reference's view,
    R_source and t_source into the target frame about the centre; ``sigma`` is that of one metre's range.
    """
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    J = np.empty(6)
    for k in range(0, points.shape[0], step):
        p0, p1, p2 = anchors[k, 0], anchors[k, 1], anchors[k, 2]
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        y0 = R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2 + t[0]
        y1 = R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2 + t[1]
        y2 = R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2 + t[2]
        m0 = R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2
        m1 = R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2
        m2 = R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2
        if y2 <= 0:
            continue
        cosine = -(m0 * y0 + m1 * y1 + m2 * y2) / (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5
        if cosine < MIN_COS:
            continue
        u = int(np.floor(y0 / y2 * fx + cx + 0.5))
        v = int(np.floor(y1 / y2 * fy + cy + 0.5))
        kind = FACING if cosine > FACING_COS else OBLIQUE
        if unseen(sides, u, v, w, h):
            continue
        if u < 0 or v < 0 or u >= w or v >= h or depth[v, u] <= 0:
            counts[kind, NONE] += 1
            place = OUTSIDE
            if u >= 0 and v >= 0 and u < w and v < h and distance(beside, u, v) <= margin:
                place = UNKNOWN
            nats[place] += np.log(shares[kind, NONE])
            numbers[place] += 1
            continue
        if depth_map[v, u] <= 0:
            continue  # an edge of the target: no statement
        q = depth_map[v, u]
        q0, q1, q2 = normal_map[v, u, 0], normal_map[v, u, 1], normal_map[v, u, 2]
        r0, r1 = (u - cx) / fx, (v - cy) / fy
        slope = q0 * r0 + q1 * r1 + q2
        cosine_there = -slope / (r0 * r0 + r1 * r1 + 1) ** 0.5
        if cosine_there <= 0:
            continue
        # along the pixel's ray: positive behind what is seen there
        off = (q0 * (y0 - r0 * q) + q1 * (y1 - r1 * q) + q2 * (y2 - q)) / slope
        # what was measured, where the fitted plane says it was: a fit rounds ridges
        f0, f1, f2 = points[k, 0] - p0, points[k, 1] - p1, points[k, 2] - p2
        off += (
            q0 * (R[0, 0] * f0 + R[0, 1] * f1 + R[0, 2] * f2)
            + q1 * (R[1, 0] * f0 + R[1, 1] * f1 + R[1, 2] * f2)
            + q2 * (R[2, 0] * f0 + R[2, 1] * f1 + R[2, 2] * f2)
        ) / slope
        least = max(min(cosine, cosine_there), 0.2)
        level, slant = sigma * y2 * y2, slope_sigma * slope_sigma * (1.0 / (least * least) - 1.0)
        variance = POINT_VARIANCE * (level * level + slant)
        hit = 0.0
        if q0 * m0 + q1 * m1 + q2 * m2 > SAME_NORMAL_COS:
            hit = (
                shares[kind, HIT]
                * np.exp(-0.5 * min(off * off / variance, 80.0))
                / (2 * np.pi * variance) ** 0.5
            )
        side = LONG if off < 0 else SHORT
        other = shares[kind, side] * even
        part = hit / (hit + other)
        place = BEHIND if side == SHORT and part < 0.5 else MET
        nats[place] += np.log(hit + other)
        numbers[place] += 1
        counts[kind, HIT] += part
        counts[kind, side] += 1 - part
        if not expand or part < 1e-3 or cosine_there < 0.25:
            continue
        X0 = R_source[0, 0] * p0 + R_source[0, 1] * p1 + R_source[0, 2] * p2 + t_source[0]
        X1 = R_source[1, 0] * p0 + R_source[1, 1] * p1 + R_source[1, 2] * p2 + t_source[1]
        X2 = R_source[2, 0] * p0 + R_source[2, 1] * p1 + R_source[2, 2] * p2 + t_source[2]
        c0 = (R_reference[0, 0] * q0 + R_reference[0, 1] * q1 + R_reference[0, 2] * q2) / slope
        c1 = (R_reference[1, 0] * q0 + R_reference[1, 1] * q1 + R_reference[1, 2] * q2) / slope
        c2 = (R_reference[2, 0] * q0 + R_reference[2, 1] * q1 + R_reference[2, 2] * q2) / slope
        J[0], J[1], J[2] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2, X0 * c1 - X1 * c0
        J[3], J[4], J[5] = c0, c1, c2
        weight = part / variance
        for i in range(6):
            g[i] += weight * J[i] * off
            for j in range(i, 6):
                H[i, j] += weight * J[i] * J[j]
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]


@kernel(fastmath=True)
def _accumulate_pairs(
    addresses: Addresses, sizes: Addresses, intrinsics: Array, margins: Array, poses: Array, centre: Array,
    directions: Addresses, order: Addresses,
    sigma: float, slope_sigma: float, shares: Array, even: float,
    H: Array, g: Array, counts: Array, nats: Array, numbers: Array,
) -> None:  # fmt: skip
    """:func:`_accumulate` of many directions (m, 2) of pairs, into arrays with a row for each."""
    for n in order:
        i, j = directions[n]
        own, other, h, w = addresses[i], addresses[j], sizes[j, HEIGHT], sizes[j, WIDTH]
        points = sizes[i, POINT_COUNT]
        R_i, R_j = poses[i, :3, :3].copy(), poses[j, :3, :3].copy()
        R, t = R_j.T @ R_i, R_j.T @ (poses[i, :3, 3] - poses[j, :3, 3])
        _accumulate(
            vectors(own, POINTS, points), vectors(own, ANCHORS, points), vectors(own, NORMALS, points),
            R, t, R_i, poses[i, :3, 3] - centre, R_j,
            image(other, DEPTH, h, w), image(other, DEPTH_MAP, h, w),
            normal_image(other, h, w), steps(other, h, w), open_sides(other),
            intrinsics[j], margins[j], sigma, slope_sigma, shares, even, 1, True,
            H[n], g[n], counts[n], nats[n], numbers[n],
        )  # fmt: skip
