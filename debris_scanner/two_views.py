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

"""Two depth images of one target, registered to each other without a scan."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from debris_scanner.core.frames import DepthFrame, TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.results import Checks
from debris_scanner.mapping.closures import verify
from debris_scanner.sensing.hints import checked_unit
from debris_scanner.sensing.normals import fit_normals
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings


@dataclass(frozen=True)
class Registration:
    """How one view lies to another; true if they agree."""

    T_a_b: Array | None  # (4, 4), maps points of view b into view a, metres; None if they do not overlap
    accepted: bool  # the views show the same surface there
    why: str  # the checks in words
    checks: Checks

    def __bool__(self) -> bool:
        """Whether the two views agree."""
        return self.accepted


def register(
    a: DepthFrame, b: DepthFrame, T_a_b: Array | None = None, settings: Settings | None = None
) -> Registration:
    """Register two depth images of one rigid target.

    All that has a depth is the target: set what stands still to 0. The search is local, as from frame to
    frame: a start that is some 10 degrees off is near enough.

    Args:
        a: one view.
        b: the other.
        T_a_b: (4, 4), where the search starts; None: the target has not moved.
        settings: None: the defaults.

    Raises:
        ValueError: a view shows too little for a surface, its depths are no metres, or the start is no rigid
            motion.
    """
    settings = settings or Settings()
    start = np.eye(4) if T_a_b is None else _rigid(T_a_b)
    reference, view = (_view(frame, name, settings) for frame, name in ((a, 'a'), (b, 'b')))
    found = verify(view, start, reference, np.eye(4), settings.verification)
    return Registration(found.T_target_view, found.accepted, found.why, found.checks)


def _view(frame: DepthFrame, name: str, settings: Settings) -> View:
    """A depth image prepared for registration."""
    if not isinstance(frame, DepthFrame):
        raise ValueError(f'view {name} must be a DepthFrame, not {type(frame).__name__}')
    checked_unit(frame.depth, settings.isolation.box_max[2])
    fitted, normals = fit_normals(frame.depth, frame.camera, settings.normals)
    view = View(TargetFrame(frame.stamp_ns, frame.camera, frame.depth, fitted, normals, frame.rgb))
    if not len(view.points):
        raise ValueError(f'view {name} shows no surface: {np.count_nonzero(frame.depth)} pixels have a depth')
    return view


def _rigid(T: Any) -> Array:
    """A pose (4, 4), checked."""
    T = np.asarray(T, np.float64)
    if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6):
        raise ValueError(f'T_a_b must be a rigid motion (4, 4), not of shape {T.shape}')
    return T
