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

"""Views of the target, prepared for registration: sampled surface, depth and normal maps, silhouette.

A `Surface` holds the points of a view or a model; a `View` adds the maps that other views' points are
compared with. Its reference depth is the fitted one, which is less noisy, but the measured one on ridges,
where fitted planes round what is sharp. That is compiled, because it runs on every frame.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array, apply
from debris_scanner.core.optional import kernel
from debris_scanner.sensing.normals import NormalSettings, fit_rows, is_porous, outline
from debris_scanner.sensing.picture import Picture
from debris_scanner.sensing.rim import NO_EDGES, EdgePoints, Rim, edge_points, find_rim
from debris_scanner.sensing.silhouette import Mask, Steps, open_sides, steps_beside

Image = NDArray[np.float32]

SAMPLE_STRIDE = 3  # pixels between the points that are registered
FEW_PIXELS = 5400  # with fewer the points lie closer, so that some six hundred are left
MIN_INCIDENCE_COS = 0.2  # surfaces seen more obliquely are not sampled
FACING_COS = 0.64  # where noise is measured
FEWEST_FACING = 30
STEP_SAMPLE = 500  # pixels whose depths tell the step of all
MAD_TO_SIGMA = 1.4826
OUTLYING = 6.0  # standard deviations
USUAL_NOISE = 1.2  # px: what the bounds that are multiples of the resolution allow for
RIDGE_REACH_PX = 3  # either side of a ridge
RIDGE_COS = 0.96  # between the normals there


@dataclass
class Surface:
    """Points (n, 3) and unit normals (n, 3), float32, of a view or a model, in its own frame.

    ``anchors`` are the same points with less noise, where available: they are projected and serve as lever
    arms. With the measured points instead, their noise would enter both the residual and, through the pixel
    looked up and the lever arm, its derivative; every estimated rotation would come out some per cent short.

    ``rim`` holds points that must project inside another view's silhouette: a view's own rim, any point of a
    model. ``unoccluded`` is false for a partially occluded view, whose rim may be the occluder's shadow. That
    rim must still lie inside an unoccluded view's silhouette, and edges may match edges; between two such
    views it is no evidence. ``porous`` is true if missing pixels are no evidence at all. ``point_area`` is
    the area of a model's surface per point, m². ``density`` tells how much closer the points lie than usual:
    what neighbouring pixels say is correlated, so that closer points say no more. ``shared_noise`` is how
    much of a point's noise its anchor has too, 0 to 1. ``picture`` is what the frame's colours show of the
    points; None without colours.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    anchors: NDArray[np.float32]
    rim: Rim
    unoccluded: bool = True
    porous: bool = False
    point_area: float = 0.0
    density: float = 1.0
    shared_noise: float = 0.0
    picture: Picture | None = None

    def only(self, chosen: NDArray[np.intp]) -> 'Surface':
        """Chosen points of a model, which need not be inside another view's silhouette."""
        points, normals = self.points[chosen], self.normals[chosen]
        nothing = np.zeros((0, 3), np.float32)
        return Surface(points, normals, points, Rim(nothing, nothing, np.zeros(0, np.uint8)))

    def thinned(self, step: int) -> Self:
        """The same with every step-th point, for many fits in little time."""

        def some(values: NDArray[Any]) -> NDArray[Any]:
            return np.ascontiguousarray(values[::step])

        rim, thin = self.rim, copy(self)
        for name in ('centroid', 'gyration_square'):  # of all points
            thin.__dict__.pop(name, None)
        thin.points, thin.normals, thin.anchors = some(self.points), some(self.normals), some(self.anchors)
        if self.picture is not None:
            thin.picture = self.picture.thinned(step)
        thin.point_area, thin.density = self.point_area * step, self.density / step  # each stands for so many
        thin.rim = Rim(some(rim.points), some(rim.normals), some(rim.edge))
        return thin

    @staticmethod
    def sampled(points: NDArray[np.float32], normals: NDArray[np.float32], count: int) -> 'Surface':
        """At most ``count`` random points (n, 3) of a model, with their unit normals (n, 3)."""
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(points), min(count, len(points)), replace=False)
        p = np.ascontiguousarray(points[chosen], np.float32)
        n = np.ascontiguousarray(normals[chosen], np.float32)
        return Surface(p, n, p, Rim(p, n, np.zeros(len(p), np.uint8)))


class _Prepared:
    """An attribute of a view, made with all others of its kind when the first of them is asked for."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, view: 'View', owner: type) -> Any:
        view._prepare()
        return view.__dict__[self.name]


class View(Surface):
    """A target frame for registration: sampled surface, maps, silhouette and edges.

    What takes time is prepared once somebody asks for it: a tracked target's pose takes little of it.
    """

    points: Any = _Prepared()
    normals: Any = _Prepared()
    anchors: Any = _Prepared()
    rim: Any = _Prepared()
    porous: Any = _Prepared()
    density: Any = _Prepared()
    shared_noise: Any = _Prepared()
    picture: Any = _Prepared()
    depth_map: Any = _Prepared()  # (h, w), metres: see :func:`reference_depth`
    normal_map: Any = _Prepared()  # (h, w, 3)
    edges: Any = _Prepared()
    depth_step: Any = _Prepared()  # m
    noise: Any = _Prepared()  # m, of a depth about the fitted planes

    def __init__(self, frame: TargetFrame) -> None:
        camera = frame.camera
        self.frame = frame
        self.unoccluded = True
        self.footprint = frame.footprint  # m, of a pixel at the target's range
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])

    def _prepare(self) -> None:
        frame = self.frame
        self.depth_map = reference_depth(frame)
        self.normal_map = frame.normals
        silhouette = self._silhouette
        porous = is_porous(frame.depth, silhouette)
        fitted = int(np.count_nonzero((frame.depth > 0) & (frame.depth_fit > 0)))
        stride = (
            1 if porous else min(SAMPLE_STRIDE, max(1, round(SAMPLE_STRIDE * np.sqrt(fitted / FEW_PIXELS))))
        )
        points, n, anchors, incidence = _sampled(
            frame.depth, frame.depth_fit, frame.normals, stride, self.intrinsics
        )
        keep = incidence > MIN_INCIDENCE_COS
        self.depth_step = depth_step(points[:, 2])
        self.noise = noise_about_planes(points[:, 2] - anchors[:, 2], incidence)
        rim, self.edges = find_rim(frame, self.intrinsics, silhouette)
        super().__init__(
            points[keep],
            n[keep],
            anchors[keep],
            rim,
            unoccluded=self.unoccluded,
            porous=porous,
            density=1.0 if porous else (SAMPLE_STRIDE / stride) ** 2,
            shared_noise=min(1.0, max(0.0, 2 * noise_correlation(frame, SAMPLE_STRIDE, self.noise))),
            picture=None if frame.rgb is None else Picture(frame, stride, points[keep]),
        )

    @property
    def resolution(self) -> float:
        """What the view resolves, m: a pixel's footprint, or more for larger noise or steps of its depths."""
        return max(self.footprint, self.noise / USUAL_NOISE, self.depth_step)

    def glimpse(self, settings: NormalSettings, every: int, like: 'View') -> 'View':
        """The same for a look at every so many-th row alone, without edges.

        Args:
            settings: to fit the planes there.
            every: so many-th row is fitted.
            like: another view of the same target, whose noise is this one's.
        """
        fitted, normals = fit_rows(self.frame, settings, every)
        other, frame = copy(self), self.frame
        other.frame = TargetFrame(frame.stamp_ns, frame.camera, frame.depth, fitted, normals)
        other.depth_map, other.normal_map, other.beside = (
            fitted,
            normals,
            steps_beside(self.frame.depth > 0, every),
        )
        other.noise, other.depth_step, other.porous = like.noise, like.depth_step, like.porous
        other.edges = NO_EDGES
        return other

    @cached_property
    def beside(self) -> Steps:
        """Columns and rows (h, w, 2) from the silhouette."""
        return steps_beside(self._silhouette, 1)

    @cached_property
    def open_sides(self) -> Mask:
        """Sides (4,) beyond which nothing is known: see :func:`open_sides`."""
        return open_sides(self.frame.depth > 0)

    @cached_property
    def edge_points(self) -> EdgePoints:
        """The edges as points."""
        return edge_points(self.frame, self.intrinsics, self.edges)

    @cached_property
    def _silhouette(self) -> Mask:
        return outline(self.frame.depth)

    @cached_property
    def centroid(self) -> Array:
        """Mean of the sampled points (3,), view frame, metres."""
        return np.asarray(self.points.mean(axis=0), dtype=np.float64)

    @cached_property
    def gyration_square(self) -> float:
        """Their radius of gyration squared, m²: mean squared distance from the centroid."""
        return float(((self.points - self.centroid) ** 2).sum(axis=1).mean())


def depth_step(depth: NDArray[np.float32]) -> float:
    """Smallest step between depths (n,), m: a millimetre in most depth images, next to none in clouds."""
    steps = np.diff(np.unique(depth[:: max(1, len(depth) // STEP_SAMPLE)]))
    return float(np.round(steps.min(), 5)) if len(steps) else 0.0


def noise_about_planes(residuals: NDArray[np.floating], incidence: NDArray[np.floating]) -> float:
    """Standard deviation, m, of depth about the fitted planes (n,), where they face the sensor.

    Noise that is correlated over the window of the fit does not show: it is a lower bound.

    Args:
        residuals: measured less fitted depth, m.
        incidence: cosine.
    """
    facing = residuals[incidence > FACING_COS]
    return float(MAD_TO_SIGMA * np.median(np.abs(facing))) if len(facing) >= FEWEST_FACING else 0.0


def noise_correlation(frame: TargetFrame, stride: int, noise: float) -> float:
    """Correlation of the noise about the fitted planes between pixels side by side, 0 where it is unknown.

    Args:
        frame: the target.
        stride: between the rows that are looked at.
        noise: its standard deviation, m; what is further off is no noise.
    """
    depth, fitted = frame.depth[::stride], frame.depth_fit[::stride]
    off = np.where(
        (depth > 0) & (fitted > 0) & (frame.normals[::stride, :, 2] < -FACING_COS), depth - fitted, 0
    )
    off[np.abs(off) > OUTLYING * noise] = 0
    left, right = off[:, :-1], off[:, 1:]
    both = (left != 0) & (right != 0)
    if np.count_nonzero(both) < FEWEST_FACING:
        return 0.0
    left, right = left[both], right[both]
    return float(2 * (left @ right) / (left @ left + right @ right))


def angles_between(views: Sequence[View], poses: Sequence[Array]) -> Array:
    """Angles (n, n), rad, between the viewing directions of posed views (T_target_view)."""
    centre = np.mean([apply(T, v.centroid) for T, v in zip(poses, views, strict=True)], axis=0)
    eyes = np.array([T[:3, 3] for T in poses]) - centre
    eyes /= np.linalg.norm(eyes, axis=1)[:, None]
    return np.asarray(np.arccos(np.clip(eyes @ eyes.T, -1, 1)))


def reference_depth(frame: TargetFrame) -> NDArray[np.float32]:
    """Depth (h, w), metres, that other views' points are compared with, 0 where there is none.

    The fitted depth is less noisy, but it rounds ridges, oblique ones more; there the measured one is used.
    """
    return depth_with_ridges(frame.depth, frame.depth_fit, frame.normals, RIDGE_REACH_PX, RIDGE_COS)


@kernel()
def depth_with_ridges(depth: Image, depth_fit: Image, normals: Image, reach: int, cosine: float) -> Image:
    """Fitted depth (h, w), metres, but the measured one on ridges; 0 where nothing is fitted.

    On a ridge the normals ``reach`` pixels to either side, above and below or left and right, differ by more
    than the angle of ``cosine``.
    """
    h, w = depth.shape
    out = depth_fit.copy()
    least = np.float32(cosine)
    for v in range(h):
        for u in range(w):
            if depth_fit[v, u] <= 0:
                continue
            ridge = False
            if reach <= v < h - reach:
                ridge = _dot(normals[v - reach, u], normals[v + reach, u]) < least
            if not ridge and reach <= u < w - reach:
                ridge = _dot(normals[v, u - reach], normals[v, u + reach]) < least
            if ridge:
                out[v, u] = depth[v, u]
    return out


@kernel()
def _sampled(
    depth: Image, depth_fit: Image, normals: Image, stride: int, intrinsics: Array
) -> tuple[Image, Image, Image, Image]:
    """Points (n, 3) of every stride-th row and column, their normals and anchors, and the incidence (n,).

    Incidence is the cosine between normal and ray.
    """
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    most = ((h - 1) // stride + 1) * ((w - 1) // stride + 1)
    points, normal, anchors = np.empty((3, most, 3), np.float32)
    incidence = np.empty(most, np.float32)
    n = 0
    for v in range(0, h, stride):
        for u in range(0, w, stride):
            z, fitted = depth[v, u], depth_fit[v, u]
            if z <= 0 or fitted <= 0:
                continue
            p, m = points[n], normals[v, u]
            p[0], p[1], p[2] = (u - cx) / fx * z, (v - cy) / fy * z, z
            anchors[n], normal[n] = p * (fitted / z), m
            incidence[n] = -_dot(m, p) / np.sqrt(_dot(p, p))
            n += 1
    return points[:n], normal[:n], anchors[:n], incidence[:n]


@kernel()
def _dot(a: Image, b: Image) -> np.float32:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
