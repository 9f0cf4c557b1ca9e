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

"""Probability that two frames show the same face: likeness of the views joined with the attitude.

Trowbridge 2014, sections 2.10.5 and 2.10.6.
"""

import numpy as np

from debris_scanner.geometry import Array


def relative_angle(R: Array, rotations: Array) -> Array:
    """Angle (n,), 0..pi, between a rotation matrix (3, 3) and many (n, 3, 3).

    The wrapped principal angle of Trowbridge 2014, eq. 2.95-2.100, without the detour over quaternions
    and their two signs. The same whether the rotations map sensor to target or back.
    """
    # |R_u - R_v| = sqrt(8) sin(angle / 2) and trace(R_u^T R_v) = 4 cos(angle / 2)^2 - 1; the
    # sine keeps all digits of small angles, where arccos of the trace alone loses half of them.
    sine = np.sqrt(((rotations - R) ** 2).sum(axis=(-2, -1)) / 8.0)
    cosine = np.sqrt(np.maximum((rotations * R).sum(axis=(-2, -1)) + 1.0, 0.0)) / 2.0
    return np.asarray(2.0 * np.arctan2(sine, cosine))


def attitude_probability(R: Array, rotations: Array) -> Array:
    """P_beta (n,) of a rotation (3, 3) against many (n, 3, 3), Trowbridge 2014, eq. 2.101.

    1 for the same attitude, 0 for opposite ones, linear in between. It inherits the drift of the
    attitude estimate, and it wrongly separates views that differ by a turn about the line of sight.
    """
    return 1.0 - relative_angle(R, rotations) / np.pi


def joint_probability(similarity: Array, attitude: Array) -> Array:
    """P_closure = sqrt(P_s P_beta), elementwise, Trowbridge 2014, eq. 2.102."""
    return np.asarray(np.sqrt(similarity * attitude))
