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

"""Angular rate from two aligned frames: rotation angle over elapsed time about the rotation axis (T6).

Trowbridge 2014, section 2.7.1, eq. 2.41-2.49 and 2.61. Eq. 2.42 turns a rotation round by negating the
scalar part, which gives minus the conjugate: the same rotation, but with an angle of 2 pi minus the
wanted one if taken at its word. The sign is normalised before the angle is read off (erratum 6).
"""

from dataclasses import dataclass

from debris_scanner.core.geometry import Array
from debris_scanner.thesis.euler_parameters import of_rotation, reversed_rotation, rotation_vector


@dataclass(frozen=True)
class RateObservation:
    """Observation of both estimators: what frame-to-frame alignment says at the newer frame's time."""

    stamp_ns: int
    omega: Array | None  # (3,), rad/s, Y of eq. 2.49; None where the two frames could not be aligned
    fitness: float  # d_k, m²


def angular_rate(R_previous_current: Array, dt: float) -> Array:
    """Observation Y (3,), rad/s: mean rate of the target between two frames, sensor axes, eq. 2.48 and 2.49.

    Args:
        R_previous_current: rotation (3, 3) that aligns the newer frame with the one before, from ICP.
        dt: time between them, seconds.

    A turn by more than half a revolution between two frames cannot be told from a smaller one the
    other way round.

    Raises:
        ValueError: if no time has passed.
    """
    if not dt > 0:
        raise ValueError(f'frames must be apart in time, not {dt} s')
    return rotation_vector(reversed_rotation(of_rotation(R_previous_current))) / dt
