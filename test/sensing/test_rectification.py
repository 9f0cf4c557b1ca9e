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

"""Images of a lens that distorts: each model's rays against a plane and a step that are known."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.rectification import Distortion, Rectifier

CAMERA = Camera(250.0, 252.0, 158.0, 121.0, 320, 240)
LENSES = {
    'wide D4xx': Distortion('plumb_bob', (-0.055, 0.066, 0.0005, -0.0003, -0.021)),
    'strong': Distortion('plumb_bob', (-0.28, 0.07, 0.001, -0.002)),
    'Azure NFOV': Distortion('rational_polynomial', (4.42, 2.78, 6e-5, -3e-5, 0.14, 4.75, 4.11, 0.75)),
    'fisheye': Distortion('equidistant', (0.01, -0.003, 0.001, -0.0002)),
}


def rays(camera, lens):
    """x, y of the ray of each pixel (h, w) of the distorted image, by Newton's method on the lens's model."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    wanted = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy])
    at, step = wanted.copy(), 1e-6
    for _ in range(50):
        here = np.stack(lens.distorted(*at))
        dx, dy = (
            (np.stack(lens.distorted(at[0] + a, at[1] + b)) - here) / step for a, b in ((step, 0), (0, step))
        )
        miss = wanted - here
        det = dx[0] * dy[1] - dx[1] * dy[0]
        at[0] += (miss[0] * dy[1] - miss[1] * dy[0]) / det
        at[1] += (miss[1] * dx[0] - miss[0] * dx[1]) / det
    assert np.abs(np.stack(lens.distorted(*at)) - wanted).max() < 1e-9
    return at


def plane(x, y):
    """Depth along rays (x, y, 1) of a slanted plane 0.8 m away."""
    return (0.8 / (1 + 0.5 * x - 0.3 * y)).astype(np.float32)


@pytest.mark.parametrize('name', LENSES)
def test_a_plane_is_a_plane_again_and_keeps_its_place(name):
    lens = LENSES[name]
    rectifier = Rectifier(CAMERA, lens)
    camera = rectifier.camera
    assert (camera.fx, camera.fy) == (CAMERA.fx, CAMERA.fy)
    seen = rectifier.depth(plane(*rays(CAMERA, lens)))
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    true = plane((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    valid = seen > 0
    assert valid.sum() > 0.85 * CAMERA.width * CAMERA.height
    assert valid[camera.height // 2, camera.width // 2]
    error = np.abs(seen - true)[valid]
    assert np.percentile(error, 99) < 2e-5  # a pixel beside would be 1 mm off
    assert error.max() < 2e-3


def test_nothing_is_made_up_across_a_step():
    depth = np.where(np.arange(320)[None, :] < 160, 0.5, 0.9) * np.ones((240, 1))
    seen = Rectifier(CAMERA, LENSES['strong']).depth(depth.astype(np.float32))
    assert set(np.unique(seen)) <= {np.float32(0), np.float32(0.5), np.float32(0.9)}


def test_holes_stay_holes_and_do_not_spread():
    depth = np.full((240, 320), 0.7, np.float32)
    depth[100:104, 150:160] = np.nan
    depth[60, 60] = 0
    seen = Rectifier(CAMERA, LENSES['wide D4xx']).depth(depth)
    whole = Rectifier(CAMERA, LENSES['wide D4xx']).depth(np.full((240, 320), 0.7, np.float32))
    assert 35 <= np.count_nonzero(whole) - np.count_nonzero(seen) <= 50
    assert not np.isnan(seen).any()


def test_colour_goes_with_its_depth():
    lens = LENSES['Azure NFOV']
    x, y = rays(CAMERA, lens)
    rgb = np.stack([x, y, x - y], axis=-1)
    rgb = np.clip(128 + 100 * rgb, 0, 255).astype(np.uint8)
    rectifier = Rectifier(CAMERA, lens)
    camera, seen = rectifier.camera, rectifier.colour(rgb)
    u = np.arange(camera.width)[None, :]
    true = 128 + 100 * (u - camera.cx) / camera.fx
    lit = seen.any(axis=-1) & (np.abs(true - 128) < 100)
    assert lit.sum() > 50_000
    assert np.abs(seen[..., 0] - true)[lit].max() < 2


def test_an_image_is_not_taken_from_where_a_polynomial_turns_back():
    lens = Distortion('plumb_bob', (-0.4, 0.0, 0.0, 0.0, 0.0))
    assert lens.reach == pytest.approx((1 / 1.2) ** 0.5, rel=0.02)
    rectifier = Rectifier(Camera(100.0, 100.0, 159.5, 119.5, 320, 240), lens)
    radius = np.hypot(rectifier.camera.width, rectifier.camera.height) / 2 / 100
    assert radius < 1.5


def test_names_of_other_makers():
    assert Distortion.of('Brown Conrady', [0.1, 0, 0, 0, 0]).model == 'plumb_bob'
    assert Distortion.of('fisheye', [0.1, 0, 0, 0]).model == 'equidistant'
    assert Distortion.of('', [0.1, 0, 0, 0, 0]).model == 'plumb_bob'
    assert Distortion.of('anything', [0.0] * 5) is None
