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

"""Shiny multi-layer insulation: it returns light only where it faces the sensor (thesis part T23).

After Calderita et al., quoted in the thesis (sections 1.2.6 and 6.2.3): at 20 degrees of incidence 65 %
(gold) and 47 % (silver) of the pixels report nothing; at 40 and 60 degrees both are invisible. Their range
noise for silver, 0.12 mm at 2 m, is far below the noise already modelled. A blanket that covers a part of the
target lies in a few large patches.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.sim.surface import sample_mesh
from debris_scanner.sim.targets import Target

# Share of pixels that return, against the angle of incidence: gold and silver averaged.
_ANGLES_DEG = np.array([0.0, 20.0, 40.0])
_RETURNS = np.array([1.0, 0.44, 0.0])

_CRINKLE_RAD = 0.12  # standard deviation of the blanket's slope
_CRINKLE_M = (0.008, 0.025)  # wavelengths
_WAVES = 6
_CRINKLE_SEED, _PATCH_SEED = 11, 12  # a blanket's crinkles belong to the target, not to the noise
_PATCH_EXTENTS = (0.5, 1.2)  # wavelengths of the patches that a blanket covers
_SAMPLES = 4000  # points of the surface, of which the covered share is measured


def _waves(
    wavelengths: tuple[float, float], seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Wave vectors (n, 3), directions (n, 3) and phases (n,) of random plane waves."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(_WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    number = direction * (2 * np.pi / rng.uniform(*wavelengths, (_WAVES, 1)))
    return (
        number.astype(np.float32),
        direction.astype(np.float32),
        rng.uniform(0, 2 * np.pi, _WAVES).astype(np.float32),
    )


_NUMBER, _DIRECTION, _PHASE = _waves(_CRINKLE_M, _CRINKLE_SEED)


class Insulation:
    """A crinkled blanket on a target."""

    def __init__(self, target: Target, share: float = 1.0) -> None:
        """Lay it out.

        Args:
            target: what it covers; not empty.
            share: of the surface that is covered, in 0..1.
        """
        self._extent = float(np.ptp(target.vertices, axis=0).max())
        self._number, _, self._phase = _waves(_PATCH_EXTENTS, _PATCH_SEED)
        points = sample_mesh(target.vertices, target.triangles, _SAMPLES).astype(np.float32)
        level = np.inf if share == 1 else np.quantile(self._patches(points), share)
        self._level = np.float32(level)

    def covers(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether points (..., 3) of the surface, target frame, lie below it."""
        return np.asarray(self._patches(points) < self._level)

    def returns(
        self, points: NDArray[np.float32], normals: NDArray[np.float32], to_sensor: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Chance (h, w) that a pixel returns.

        Args:
            points: (h, w, 3) on the surface, target frame, metres.
            normals: (h, w, 3) unit, towards the sensor.
            to_sensor: (h, w, 3) unit.
        """
        slope = np.sin(points @ _NUMBER.T + _PHASE) @ _DIRECTION
        # each component of the slope has variance waves / 2 / 3
        crinkled = normals + slope * np.float32(_CRINKLE_RAD / np.sqrt(_WAVES / 6))
        crinkled /= np.linalg.norm(crinkled, axis=-1, keepdims=True)
        cosine = np.clip(np.einsum('ijk,ijk->ij', crinkled, to_sensor), -1, 1)
        chance = np.interp(np.degrees(np.arccos(cosine)), _ANGLES_DEG, _RETURNS).astype(np.float32)
        return np.where(self.covers(points), chance, np.float32(1))

    def _patches(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        waves = np.sin(points / np.float32(self._extent) @ self._number.T + self._phase)
        return np.asarray(waves.sum(axis=-1), np.float32)
