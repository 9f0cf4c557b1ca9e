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

"""Can the target's rotation be seen at all? A body of revolution turns without changing its image."""

import numpy as np

from debris_scanner.geometry import Array, apply, hat
from debris_scanner.views import View


def rotation_observability(H: Array, matched: float, view: View, T_target_view: Array) -> float:
    """Smallest rotation information per matched point, relative to the target's size squared.

    The registration's normal matrix is moved to the view's centroid, its translation marginalised, and
    the smallest eigenvalue taken over n r². A cylinder about its axis stays near 0.0005, anything that
    shows its rotation above 0.002.

    Args:
        H: normal matrix (6, 6) for a twist in the target frame.
        matched: number of matched points behind it.
        view: the registered view.
        T_target_view: (4, 4).
    """
    rotation, _ = marginal_rotation(H, apply(T_target_view, view.centroid))
    radius_square = float(((view.points - view.centroid) ** 2).sum(axis=1).mean())
    return float(np.linalg.eigvalsh(rotation)[0] / (max(matched, 1.0) * radius_square))


def marginal_rotation(H: Array, centre: Array) -> tuple[Array, Array]:
    """Information (3, 3) on a rotation about a centre, and the shift (3, 3) of it that goes best with a turn.

    Args:
        H: normal matrix (6, 6) for a twist in the target frame; its translation is marginalised.
        centre: (3,), target frame.
    """
    A = np.eye(6)
    A[3:, :3] = hat(centre)
    Hc = A.T @ H @ A
    shift = -np.linalg.pinv(Hc[3:, 3:], rcond=1e-6) @ Hc[3:, :3]
    return Hc[:3, :3] + Hc[:3, 3:] @ shift, shift
