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

"""What a camera shows of a target beside its depth: paint under a lamp, or the echo of its own light."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.core.parameters import did_you_mean
from debris_scanner.sim.rays import Rays
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import BACKGROUND, Target, paint_at

STRIPES, MARKINGS, PLAIN = PAINTS = 'stripes', 'markings', 'plain'
LAMP, GLOSSY = LIGHTS = 'lamp', 'glossy'

_WHITE, _BLACK = 170, 16  # of 255: a camera exposes so that paint does not saturate
_BAND = (0.12, 0.22)  # of the length, from the middle: two black quarters
_LETTERS = (0.9, -2.0)  # rad: where two columns of blocks are
_LETTER, _LETTERS_END = 0.05, 0.12  # heights, of the length
_TO_LAMP = np.array([-0.6, -0.5, -0.6]) / np.linalg.norm(
    [0.6, 0.5, 0.6]
)  # sensor frame: upper left, behind it
_AMBIENT = 0.3
_GLOSS, _SHARPNESS = 0.3, 60.0  # of the highlight; Blinn's exponent
_DRIFT, _DRIFT_S = 0.2, 7.0  # of the exposure
_ECHO = 4000.0  # of white that faces the sensor, at the target's distance
_NOISE, _SHOT = 2.0, 0.5  # levels; of a square root of an echo


class Lighting:
    """The pictures of one target. They depend on pose, time and seed alone."""

    def __init__(self, target: Target, rays: Rays, paint: str, light: str | None, seed: int | None) -> None:
        """Choose paint and light.

        Args:
            target: may be empty.
            rays: of the sensor.
            paint: one of PAINTS.
            light: one of LIGHTS, fixed in the room; None: as bright everywhere.
            seed: of the noise; None: without.

        Raises:
            ValueError: unknown paint or light.
        """
        _check('paint', paint, PAINTS)
        if light is not None:
            _check('light', light, LIGHTS)
        self._rays, self._light, self._seed = rays, light, seed
        self._paint = _PAINTS[paint]
        self._size = np.ptp(target.vertices, axis=0) if len(target.vertices) else np.ones(3)
        self._target = target

    @cached_property
    def _surface(self) -> Surface | None:
        """Of the target; None of an empty one."""
        return Surface(self._target.vertices, self._target.triangles) if len(self._target.vertices) else None

    def colours(
        self, depth: NDArray[np.floating], T_sensor_target: Array, time_s: float
    ) -> NDArray[np.uint8]:
        """Colours (h, w, 3) under the lamp, as a camera with automatic exposure sees them.

        Args:
            depth: image (h, w), 0 where nothing was measured and nothing is shown.
            T_sensor_target: pose (4, 4).
            time_s: of the frame: the exposure drifts.
        """
        rgb = np.empty((*depth.shape, 3), np.uint8)
        rgb[:] = BACKGROUND
        seen = self._seen(depth, T_sensor_target)
        shown = self._paint(seen.points, self._size).astype(float)
        if self._light is not None:
            to_lamp = T_sensor_target[:3, :3].T @ _TO_LAMP
            shown *= _AMBIENT + (1 - _AMBIENT) * np.clip(seen.normals @ to_lamp, 0, 1)[:, None]
            if self._light == GLOSSY:
                half = seen.to_sensor + to_lamp
                half /= np.linalg.norm(half, axis=1)[:, None]
                facing = np.clip((seen.normals * half).sum(axis=1), 0, 1)
                shown += 255 * _GLOSS * facing[:, None] ** _SHARPNESS
            shown *= 1 + _DRIFT * np.sin(2 * np.pi * time_s / _DRIFT_S)
        shown += _NOISE * self._noise(shown.shape, time_s)
        rgb[seen.rows, seen.columns] = np.rint(np.clip(shown, 0, 255))
        return rgb

    def echo(self, depth: NDArray[np.floating], T_sensor_target: Array, time_s: float) -> NDArray[np.uint16]:
        """Brightness (h, w) of the sensor's own light that comes back: infrared, amplitude, intensity.

        It falls with the angle of incidence and the square of the distance. Arguments as of `colours`.
        """
        image = np.zeros(depth.shape, np.uint16)
        seen = self._seen(depth, T_sensor_target)
        distance = np.linalg.norm(seen.points - inverse(T_sensor_target)[:3, 3], axis=1)
        near = float(np.linalg.norm(T_sensor_target[:3, 3]))
        shown = self._paint(seen.points, self._size).mean(axis=1) / 255
        facing = np.clip((seen.normals * seen.to_sensor).sum(axis=1), 0, 1)
        shown = _ECHO * shown * facing * (near / np.maximum(distance, 1e-6)) ** 2
        shown += _SHOT * np.sqrt(np.maximum(shown, 1)) * self._noise(shown.shape, time_s)
        image[seen.rows, seen.columns] = np.rint(np.clip(shown, 1, 65535))
        return image

    def _noise(self, shape: tuple[int, ...], time_s: float) -> Array:
        if self._seed is None:
            return np.zeros(shape)
        return np.random.default_rng([self._seed, 13, round(time_s * 1e6)]).normal(size=shape)

    def _seen(self, depth: NDArray[np.floating], T: Array) -> '_Seen':
        v, u = np.nonzero(depth)
        if self._surface is None or not len(v):
            nothing = np.zeros((0, 3))
            return _Seen(v[:0], u[:0], nothing, nothing, nothing)
        ray = self._rays.directions(u.astype(np.float32), v.astype(np.float32)) @ T[:3, :3]
        origin = inverse(T)[:3, 3]
        length, normals = self._surface.cast_smooth(origin.astype(np.float32), ray.astype(np.float32))
        hit = np.isfinite(length)
        v, u, ray, normals = v[hit], u[hit], ray[hit].astype(np.float64), normals[hit].astype(np.float64)
        to_sensor = -ray / np.linalg.norm(ray, axis=1)[:, None]
        normals = normals * np.sign((normals * to_sensor).sum(axis=1))[:, None]
        return _Seen(v, u, origin + ray * length[hit, None], normals, to_sensor)


@dataclass(frozen=True)
class _Seen:
    """The target's pixels: points, unit normals and unit directions to the sensor in the target frame."""

    rows: NDArray[np.intp]  # (n,)
    columns: NDArray[np.intp]  # (n,)
    points: Array  # (n, 3), m
    normals: Array  # (n, 3), towards the sensor
    to_sensor: Array  # (n, 3)


def _check(kind: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise ValueError(
            f'unknown {kind} {name!r}: choose one of {", ".join(known)}{did_you_mean(name, known)}'
        )


def _stripes(points: Array, _size: Array) -> NDArray[np.uint8]:
    return paint_at(points)


def _plain(points: Array, _size: Array) -> NDArray[np.uint8]:
    return np.full((len(points), 3), _WHITE, np.uint8)


def _markings(points: Array, size: Array) -> NDArray[np.uint8]:
    """White with black markings on a twentieth of the surface, as a rocket: a roll pattern and letters."""
    along = int(np.argmax(size))
    height = points[:, along] / size[along]
    angle = np.arctan2(points[:, (along + 2) % 3], points[:, (along + 1) % 3])
    quarter = np.floor(angle / (np.pi / 2)).astype(int) % 2 == 0
    black = (height > _BAND[0]) & (height < _BAND[1]) & quarter
    line = np.floor((height + 0.5) / _LETTER).astype(int) % len(_ALPHABET)
    printed = np.abs(height) < _LETTERS_END
    for place in _LETTERS:
        black |= printed & (np.abs(angle - place) < 0.12) & _ALPHABET[line]
        black |= printed & (np.abs(angle - place - 0.3) < 0.06) & _ALPHABET[::-1][line]
    return np.repeat(np.where(black, _BLACK, _WHITE).astype(np.uint8)[:, None], 3, axis=1)


_ALPHABET: Final = np.random.default_rng(3).random(40) < 0.5
_PAINTS: Final[dict[str, Callable[[Array, Array], NDArray[np.uint8]]]] = {
    STRIPES: _stripes,
    MARKINGS: _markings,
    PLAIN: _plain,
}
