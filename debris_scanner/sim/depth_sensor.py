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

"""A simulated depth camera: rays cast at the target, then a Kinect v1's errors.

Noise model: axial sigma after Nguyen, Izadi and Lovell (2012), disparity quantised to 1/8 pixel at a
baseline of 75 mm, lateral scatter of the rays, drop-out at depth edges and at grazing incidence; optionally
the drop-out of shiny insulation (thesis part T23).
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array
from debris_scanner.sim.gaps import dark_side
from debris_scanner.sim.insulation import Insulation
from debris_scanner.sim.rays import Hits, PinholeRays, Window, cast
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import Target

KINECT = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
BASELINE_M = 0.075
DISPARITY_STEP_PX = 0.125

_EDGE_STEP_M = 0.015  # a depth jump between neighbours above this is an edge


@dataclass(frozen=True)
class SensorSettings:
    """Errors of the sensor; all false and zero gives the true depth in millimetres."""

    noise: bool = True  # axial and lateral noise, quantisation and drop-out
    correlated: bool = False  # axial noise is correlated over about 4 pixels, same sigma
    lateral_px: float = 0.5  # standard deviation of each ray's lateral scatter
    edge_dropout: float = 0.5  # share of the pixels at a depth edge that return nothing
    grazing_cosine: float = 0.25  # below this cosine of incidence returns thin out, to none at a third of it
    mli: float = 0.0  # share of the target's surface that is wrapped in shiny insulation


def axial_sigma(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Standard deviation of the depth, metres (Nguyen et al. 2012)."""
    return np.float32(0.0012) + np.float32(0.0019) * (depth - np.float32(0.4)) ** 2


class DepthSensor:
    """Renders one target. Frames depend on (seed, index) and the pose alone, not on their order."""

    def __init__(
        self,
        target: Target,
        settings: SensorSettings | None = None,
        seed: int = 0,
        camera: Camera = KINECT,
        clutter: Target | None = None,
        hand: Target | None = None,
    ) -> None:
        """Prepare the scenes.

        Args:
            target: may be empty.
            settings: None takes the defaults.
            seed: of all noise.
            camera: intrinsics and image size.
            clutter: still objects around the target, in the world frame; None for nothing.
            hand: that moves by itself; None for none.
        """
        self.camera = camera
        self._rays = PinholeRays(camera)
        self.settings = settings or SensorSettings()
        self._seed = seed
        self._scene = Surface(target.vertices, target.triangles) if len(target.triangles) else None
        self._vertices = np.unique(target.vertices, axis=0)
        wrapped = self._scene is not None and self.settings.mli > 0
        self._insulation = Insulation(target, self.settings.mli) if wrapped else None
        self._clutter = Surface(clutter.vertices, clutter.triangles) if clutter is not None else None
        self._clutter_corners = clutter.vertices if clutter is not None else np.zeros((0, 3), np.float32)
        self._still_clutter: Hits | None = None
        self._hand = Surface(hand.vertices, hand.triangles) if hand is not None else None
        self._hand_corners = hand.vertices if hand is not None else np.zeros((0, 3), np.float32)

    def render(
        self,
        T_sensor_target: Array,
        index: int,
        visibility: float = 1.0,
        T_sensor_world: Array | None = None,
        T_sensor_hand: Array | None = None,
    ) -> NDArray[np.uint16]:
        """Depth image (height, width) in millimetres, 0 where nothing was measured.

        Args:
            T_sensor_target: pose (4, 4) of the target.
            index: of the frame; seeds its noise.
            visibility: visible share of the target; below 1 a straight shadow covers the rest.
            T_sensor_world: pose (4, 4) of the clutter, None for identity.
            T_sensor_hand: pose (4, 4) of the hand, None while it is out of sight.
        """
        rng = np.random.default_rng([self._seed, 3, index])
        image = np.zeros((self.camera.height, self.camera.width), np.uint16)
        if self._clutter is not None:
            hits = self._clutter_hits(T_sensor_world, rng)
            if hits is not None:
                _paste(image, hits, self._measure(hits, rng, None))
        if self._hand is not None and T_sensor_hand is not None:
            window = self._rays.window(self._hand_corners, T_sensor_hand)
            if window is not None:
                hits = self._cast(self._hand, T_sensor_hand, window, rng)
                _paste(image, hits, self._measure(hits, rng, image))
        if self._scene is not None and visibility > 0:
            window = self._rays.window(self._vertices, T_sensor_target)
            if window is not None:
                hits = self._cast(self._scene, T_sensor_target, window, rng)
                measured = self._measure(hits, rng, image)
                if self._insulation is not None:
                    seen = self._insulation.returns(hits.points, hits.normals, hits.to_sensor)
                    measured[rng.random(seen.shape, np.float32) > seen] = 0
                if visibility < 1:
                    measured[dark_side(hits.depth, visibility, self._seed)] = 0
                _paste(image, hits, measured)
        return image

    def _clutter_hits(self, T_sensor_world: Array | None, rng: np.random.Generator) -> Hits | None:
        """Hits on the clutter; cast only once while it stands still relative to the sensor."""
        still = T_sensor_world is None or np.array_equal(T_sensor_world, np.eye(4))
        if still and self._still_clutter is not None:
            return self._still_clutter
        T = np.eye(4) if T_sensor_world is None else T_sensor_world
        window = self._rays.window(self._clutter_corners, T)
        if self._clutter is None or window is None:
            return None
        hits = self._cast(self._clutter, T, window, np.random.default_rng([self._seed, 4]) if still else rng)
        if still:
            self._still_clutter = hits
        return hits

    def _cast(self, surface: Surface, T: Array, window: Window, rng: np.random.Generator) -> Hits:
        """Cast the window's rays, scattered by the lateral noise, at a surface posed at T (4, 4)."""
        scatter = None
        if self.settings.noise and self.settings.lateral_px > 0:
            u0, v0, u1, v1 = window
            sigma = np.float32(self.settings.lateral_px)
            along_u = sigma * rng.standard_normal((v1 - v0, u1 - u0), np.float32)
            scatter = along_u, sigma * rng.standard_normal((v1 - v0, u1 - u0), np.float32)
        return cast(surface, self._rays, T, window, scatter)

    def _measure(
        self, hits: Hits, rng: np.random.Generator, behind: NDArray[np.uint16] | None
    ) -> NDArray[np.uint16]:
        """The sensor's measurement of the true depths: millimetres (h, w), 0 where nothing."""
        settings = self.settings
        met = np.isfinite(hits.depth)
        z = np.where(met, hits.depth, np.float32(0))
        if settings.noise:
            white = rng.standard_normal(z.shape, np.float32)
            z = z + axial_sigma(z) * (_correlate(white) if settings.correlated else white)
            step = np.float32(self.camera.fx * BASELINE_M / DISPARITY_STEP_PX)
            z = step / np.rint(step / np.maximum(z, np.float32(0.05)))
            chance = rng.random(z.shape, np.float32)
            lowest = settings.grazing_cosine / 3
            keep = (hits.cosine - lowest) / max(settings.grazing_cosine - lowest, 1e-6)
            keep = np.where(_edges(hits.depth), np.minimum(keep, 1 - settings.edge_dropout), keep)
            met &= chance < keep
        measured = np.where(met, np.rint(z * 1000), 0).astype(np.uint16)
        if behind is not None:  # clutter in front of the target hides it
            h, w = z.shape
            front = behind[hits.v0 : hits.v0 + h, hits.u0 : hits.u0 + w]
            measured = np.where((front > 0) & (measured > front), 0, measured).astype(np.uint16)
        return measured


def _correlate(white: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit white noise blurred over about 4 pixels and scaled back to unit variance."""
    sigma = 1.7
    smooth = scipy.ndimage.gaussian_filter(white, sigma, mode='wrap')
    # variance left by the filter: sum of its squared weights, 1 / (4 pi sigma^2) in two dimensions
    return np.asarray(smooth * np.float32(2 * np.sqrt(np.pi) * sigma), np.float32)


def _edges(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels (h, w) with one of four neighbours much farther or nearer, or missing."""
    edge = np.zeros(depth.shape, bool)
    filled = np.where(np.isfinite(depth), depth, np.float32(1e3))
    across = np.abs(np.diff(filled, axis=1)) > _EDGE_STEP_M
    along = np.abs(np.diff(filled, axis=0)) > _EDGE_STEP_M
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= along
    edge[:-1] |= along
    return edge


def _paste(image: NDArray[np.uint16], hits: Hits, measured: NDArray[np.uint16]) -> None:
    """Put a window's measurements (h, w) into the image, over what is behind the target."""
    h, w = measured.shape
    window = image[hits.v0 : hits.v0 + h, hits.u0 : hits.u0 + w]
    # a target pixel without return stays empty: what is behind it is occluded
    met = np.isfinite(hits.depth)
    occluded = met & ((window == 0) | (window > np.where(met, hits.depth, 0) * 1000))
    window[occluded] = measured[occluded]
