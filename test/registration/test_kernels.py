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

"""Kernels at their limits: no division by zero, no index out of the image, whatever the picture is."""

from pathlib import Path

import numpy as np
import pytest

from debris_scanner.core import optional
from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.registration.likelihood import frame_loss
from debris_scanner.registration.projective import linearise_pair, register
from debris_scanner.sensing.normals import NormalSettings, fit_normals
from debris_scanner.sensing.views import View


def view_of(depth):
    h, w = depth.shape
    camera = Camera(500.0, 500.0, (w - 1) / 2, (h - 1) / 2, w, h)
    fitted, normals = fit_normals(depth, camera, NormalSettings())
    return View(TargetFrame(1, camera, depth, fitted, normals, None))


def plate_with_a_panel():
    """A plate, and beside it a panel one pixel wide: no direction leads out of its middle."""
    depth = np.zeros((80, 100), np.float32)
    depth[20:60, 20:50] = 0.8
    depth[30:50, 70] = 0.8
    return depth


def test_an_edge_has_a_direction():
    """Out of the middle of a panel one pixel wide none leads: its outline was divided by no pixels."""
    frame = view_of(plate_with_a_panel()).frame
    flat = TargetFrame(
        1,
        frame.camera,
        frame.depth,
        frame.depth,
        np.where(frame.depth[..., None] > 0, np.float32([0, 0, -1]), np.float32(0)),
    )
    edges = View(flat).edges
    assert edges.index.max() > 50
    assert np.linalg.norm(edges.outward[1:], axis=1) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize('size', [(1, 1), (1, 60), (40, 1), (2, 40), (80, 100)])
def test_views_of_any_size_are_compared(size):
    depth = np.full(size, 0.8, np.float32)
    a, b = view_of(depth), view_of(plate_with_a_panel())
    for first, second in ((a, b), (b, a), (a, a), (b, b)):
        pair = linearise_pair(first, np.eye(4), second, np.eye(4), 8.0)
        assert np.isfinite(pair.H).all() and np.isfinite(pair.g).all()
        if len(first.points) and len(second.points):
            assert not np.isnan(frame_loss(first, np.eye(4), second, np.eye(4))).any()


def test_a_pose_that_is_no_number_registers_to_nothing():
    view = view_of(plate_with_a_panel())
    pose = np.eye(4)
    pose[0, 3] = np.nan
    assert register(view, pose, view, np.eye(4)) is None


def test_all_kernels_have_one_error_model():
    """Dividing by zero gives inf, and nothing but these two decorators compiles."""

    @optional.inlined
    def divided(a, b):
        return a / b

    @optional.kernel()
    def halved(a, b):
        return divided(a, b) / 2

    assert halved(1.0, 0.0) == np.inf
    package = Path(optional.__file__).resolve().parents[1]
    naming = {path.name for path in package.rglob('*.py') if 'njit' in path.read_text()}
    assert naming == {'kernel_cache.py', 'optional.py'}
