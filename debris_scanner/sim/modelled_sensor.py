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

"""A sensor rendered from its record: the true depths of the whole scene, then the sensor's errors.

In the order of a frame: rays scattered so that edges are jagged, the projector's or second camera's shadow,
flying pixels, random and fixed noise, quantisation, drop-out. `sensors` has the figures.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, inverse
from debris_scanner.sim.gaps import dark_side
from debris_scanner.sim.insulation import Insulation
from debris_scanner.sim.rays import Hits, Window, cast
from debris_scanner.sim.sensors import SensorModel
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import Target

_EDGE_SHARE = 0.02  # a depth jump between neighbours above this share of the depth is an edge
_JAG_LENGTH_PX = 2.0  # lag at which the correlation of an edge's jags falls to 1/e
_HIDDEN_SHARE = 0.005  # the second eye's ray must end this much before the point for that to be hidden
_FADING_SHARE = 0.05  # a flying pixel with nothing behind lies up to this share of its depth too far
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)


@dataclass(frozen=True)
class _Body:
    """A surface with its pose in the sensor frame (4, 4), and its hits in the window."""

    surface: Surface
    T: Array
    hits: Hits


class ModelledSensor:
    """Renders one target by a sensor's record. Frames depend on (seed, index) and the pose alone."""

    def __init__(
        self,
        model: SensorModel,
        target: Target,
        seed: int = 0,
        clutter: Target | None = None,
        hand: Target | None = None,
        noise: bool = True,
        mli: float = 0.0,
    ) -> None:
        """Prepare the scene and the fixed patterns.

        Args:
            model: of the sensor.
            target: may be empty.
            seed: of all noise and of the fixed patterns.
            clutter: still objects around the target, in the world frame; None for nothing.
            hand: that moves by itself; None for none.
            noise: False gives the true depths, to the step of the output.
            mli: share of the target's surface that is wrapped in shiny insulation.
        """
        self.model = model
        self._seed = seed
        self._noise = noise
        self._target = _prepared(target)
        wrapped = self._target is not None and mli > 0
        self._insulation = Insulation(target, mli) if wrapped else None
        self._clutter = None if clutter is None else _prepared(clutter)
        self._hand = None if hand is None else _prepared(hand)
        shape = (model.rays.height, model.rays.width)
        self.bumps = np.zeros(shape, np.float32)  # of the disparity, in multiples of their amplitude
        # the slow offset: share of the depth (h, w) that each pixel measures too much
        self.offset = np.zeros(shape, np.float32)
        if noise and model.bump_px > 0:
            self.bumps = _fixed_field(shape, model.bump_length_px, [seed, 7])
        if noise and model.offset_share > 0:
            field = _fixed_field(shape, model.offset_length_px, [seed, 8])
            self.offset = np.float32(model.offset_share) * field

    def render(
        self,
        T_sensor_target: Array,
        index: int,
        visibility: float = 1.0,
        T_sensor_world: Array | None = None,
        T_sensor_hand: Array | None = None,
    ) -> NDArray[np.float32]:
        """Depth (height, width) in metres, in lengths of the rays' directions; 0 where nothing was measured.

        Args:
            T_sensor_target: pose (4, 4) of the target.
            index: of the frame; seeds its noise.
            visibility: visible share of the target; below 1 a straight shadow covers the rest.
            T_sensor_world: pose (4, 4) of the clutter, None for identity.
            T_sensor_hand: pose (4, 4) of the hand, None while it is out of sight.
        """
        rng = np.random.default_rng([self._seed, 3, index])
        rays = self.model.rays
        image = np.zeros((rays.height, rays.width), np.float32)
        posed = (
            (self._target, T_sensor_target if visibility > 0 else None),
            (self._clutter, np.eye(4) if T_sensor_world is None else T_sensor_world),
            (self._hand, T_sensor_hand),
        )
        scene = [(*body, T) for body, T in posed if body is not None and T is not None]
        windows = [window for _, corners, T in scene if (window := rays.window(corners, T)) is not None]
        if not windows:
            return image
        u0, v0 = (min(w[i] for w in windows) for i in (0, 1))
        u1, v1 = (max(w[i] for w in windows) for i in (2, 3))
        window = u0, v0, u1, v1
        scatter = self._scatter((v1 - v0, u1 - u0), rng)
        bodies = [_Body(s, T, cast(s, rays, T, window, scatter, edges_only=True)) for s, _, T in scene]
        depths = np.stack([body.hits.depth for body in bodies])
        nearest = depths.argmin(axis=0)
        depth = depths.min(axis=0)
        cosine = np.stack([body.hits.cosine for body in bodies])
        cosine = np.take_along_axis(cosine, nearest[None], axis=0)[0]
        if self._noise and self.model.baseline_m > 0:
            depth[self._unseen_by_second_eye(bodies, nearest, depth)] = np.inf
        unlit = np.zeros(depth.shape, bool)
        if self._target is not None and visibility > 0:  # the first body
            unlit = (nearest == 0) & self._unlit(bodies[0].hits, visibility, rng)
        measured = self._measure(depth, cosine, window, rng) if self._noise else depth
        near, far = self.model.limits_m
        valid = np.isfinite(measured) & (measured >= near) & (measured <= far) & ~unlit
        steps = np.rint(np.where(valid, measured, 0) / np.float32(self.model.step_m))
        image[v0:v1, u0:u1] = steps * np.float32(self.model.step_m)
        return image

    def points(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (n, 3) in the sensor frame, metres, of a rendered depth (height, width), row by row."""
        v, u = np.nonzero(depth)
        directions = self.model.rays.directions(u.astype(np.float32), v.astype(np.float32))
        return (directions * depth[v, u, None]).astype(np.float32)

    def _scatter(
        self, shape: tuple[int, int], rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Shifts (h, w) of the rays along u and v, pixels: edges are jagged by them."""
        if not self._noise or self.model.jagged_px <= 0:
            return None
        sigma = np.float32(self.model.jagged_px)
        along_u = sigma * _field(shape, _JAG_LENGTH_PX, rng)
        return along_u, sigma * _field(shape, _JAG_LENGTH_PX, rng)

    def _unseen_by_second_eye(
        self, bodies: list[_Body], nearest: NDArray[np.intp], depth: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Pixels (h, w) whose point the projector or second camera does not see."""
        unseen = np.zeros(depth.shape, bool)
        eye = np.array([self.model.baseline_m, 0.0, 0.0])
        for k, body in enumerate(bodies):
            v, u = np.nonzero((nearest == k) & np.isfinite(depth))
            if not len(v):
                continue
            own = body.hits.points[v, u].astype(np.float64)
            hidden = np.zeros(len(v), bool)
            for other in bodies:
                origin = apply(inverse(other.T), eye[None])[0]
                ends = own if other is body else apply(compose(inverse(other.T), body.T), own)
                reach, _ = other.surface.cast(origin.astype(np.float32), (ends - origin).astype(np.float32))
                hidden |= reach < 1 - _HIDDEN_SHARE
            unseen[v, u] = hidden
            if self.model.second_image:
                disparity = self.model.rays.focal_px * self.model.baseline_m / depth[v, u]
                unseen[v, u] |= body.hits.u0 + u < disparity
        return unseen

    def _unlit(self, hits: Hits, visibility: float, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Pixels (h, w) of the target that are in a shade, or whose insulation reflects away."""
        unlit = np.zeros(hits.depth.shape, bool)
        if self._insulation is not None:
            seen = self._insulation.returns(hits.points, hits.normals, hits.to_sensor)
            unlit |= rng.random(seen.shape, np.float32) > seen
        if visibility < 1:
            unlit |= dark_side(hits.depth, visibility, self._seed)
        return unlit

    def _measure(
        self, true: NDArray[np.float32], cosine: NDArray[np.float32], window: Window, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """The sensor's measurement (h, w) of true depths, inf where nothing."""
        model = self.model
        u0, v0, u1, v1 = window
        met = np.isfinite(true)
        z = np.where(met, true, np.float32(1))
        sigma = model.sigma(z, cosine)
        edge = edges(true)
        if model.flying > 0:
            flies = edge & (rng.random(z.shape, np.float32) < model.flying)
            z = np.where(flies, _mixed(true, rng), z)
        z = z + sigma * _field(z.shape, model.correlation_px, rng)
        if model.bump_px > 0:
            per_px = model.bump_px / (model.rays.focal_px * model.baseline_m)
            z = z + z**2 * np.float32(per_px) * self.bumps[v0:v1, u0:u1]
        z = z * (1 + self.offset[v0:v1, u0:u1])
        if model.disparity_step_px > 0:
            step = np.float32(model.rays.focal_px * model.baseline_m / model.disparity_step_px)
            z = step / np.maximum(np.rint(step / np.maximum(z, np.float32(0.02))), 1)
        lowest = model.grazing_cosine / 3
        keep = (cosine - lowest) / max(model.grazing_cosine - lowest, 1e-6)
        keep = np.where(edge, np.minimum(keep, 1 - model.edge_dropout), keep)
        met &= rng.random(z.shape, np.float32) < keep
        return np.where(met, z, np.float32(np.inf))


def edges(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels (h, w) with a depth, and a neighbour that is much nearer or farther, or missing (inf)."""
    near = scipy.ndimage.minimum_filter(depth, footprint=_CROSS)
    far = scipy.ndimage.maximum_filter(depth, footprint=_CROSS)
    jump = (far > depth * (1 + _EDGE_SHARE)) | (near < depth * (1 - _EDGE_SHARE))
    return np.asarray(np.isfinite(depth) & jump)


def _mixed(depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Depths (h, w) between the nearest and the farthest of a pixel and its four neighbours.

    Where one of them has no depth (inf), light fades into nothing: a little behind the nearest.
    """
    near = scipy.ndimage.minimum_filter(depth, footprint=_CROSS)
    far = scipy.ndimage.maximum_filter(depth, footprint=_CROSS)
    near = np.where(np.isfinite(near), near, np.float32(0))
    far = np.where(np.isfinite(far), far, near * np.float32(1 + _FADING_SHARE))
    return near + (far - near) * rng.random(depth.shape, np.float32)


def _prepared(target: Target) -> tuple[Surface, NDArray[np.float32]] | None:
    """Surface and corners (n, 3) of a target; None of an empty one."""
    if not len(target.triangles):
        return None
    return Surface(target.vertices, target.triangles), np.unique(target.vertices, axis=0)


def _field(shape: tuple[int, ...], length_px: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Random field (h, w) of unit variance; its correlation falls to 1/e over the length; 0: white."""
    white = rng.standard_normal(shape, np.float32)
    sigma = length_px / 2  # a Gaussian of sigma correlates as exp(-(lag / 2 sigma)^2)
    if sigma < 0.25:
        return white
    reach = np.arange(-int(4 * sigma + 0.5), int(4 * sigma + 0.5) + 1)
    weights = np.exp(-0.5 * (reach / sigma) ** 2)
    left = (
        weights**2
    ).sum() / weights.sum() ** 2  # share of the variance that the blur leaves: root of its 2D share
    return np.asarray(scipy.ndimage.gaussian_filter(white, sigma, mode='wrap') / np.float32(left), np.float32)


def _fixed_field(shape: tuple[int, int], length_px: float, seed: list[int]) -> NDArray[np.float32]:
    """A sensor's own pattern (h, w): mean 0, RMS 1, correlated over a length in pixels."""
    field = _field(shape, length_px, np.random.default_rng(seed))
    field = field - field.mean()
    return np.asarray(field / field.std(), np.float32)
