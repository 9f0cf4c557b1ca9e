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

"""Pictures: ratios of colours, and brightness without shade, which no lamp and no exposure changes."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.sensing.normals import NormalSettings, fit_normals
from debris_scanner.sensing.picture import COARSE, KNOWN, LIGHT, SATURATED, logarithms, unshade
from debris_scanner.sensing.views import View

SHAPE = 80, 100
INSIDE = slice(20, 60), slice(20, 80)


def painted():
    """Soft stripes of three colours (h, w, 3) between 60 and 200."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    waves = np.stack([np.sin(u / 6), np.sin(v / 7), np.cos((u + v) / 8)], axis=-1)
    return (130 + 70 * waves).astype(np.uint8)


def plate(rgb):
    """A frame of a plate that faces the sensor, with a picture."""
    depth = np.zeros(SHAPE, np.float32)
    depth[INSIDE] = 0.8
    camera = Camera(500.0, 500.0, 49.5, 39.5, SHAPE[1], SHAPE[0])
    fitted, normals = fit_normals(depth, camera, NormalSettings())
    return TargetFrame(1, camera, depth, fitted, normals, rgb)


def test_a_lamp_changes_no_ratio():
    frame = plate(painted())
    lit = np.linspace(0.4, 1.2, SHAPE[1])[None, :, None]
    dim = plate(np.rint(painted() * lit).astype(np.uint8))
    bright, dimmed = (logarithms(f.rgb, f.depth)[:LIGHT, INSIDE[0], INSIDE[1]] for f in (frame, dim))
    assert np.ptp(bright[0]) > 0.5
    assert np.abs(bright - dimmed).mean() < 0.1 * bright.std()


def test_what_is_off_the_target_black_or_saturated_is_unknown():
    rgb = painted()
    rgb[30, 30], rgb[30, 40] = 0, (SATURATED, 90, 90)
    ratios = logarithms(rgb, plate(rgb).depth)
    assert not ratios[:, 10, 10].any() and not ratios[:, 30, 30].any() and not ratios[:, 30, 40].any()
    assert ratios[:, 31, 31].all()


@pytest.mark.parametrize('rgb', [None, np.full((*SHAPE, 3), 90, np.uint8), np.zeros((*SHAPE, 3), np.uint8)])
def test_without_colours_there_is_no_picture(rgb):
    view = View(plate(rgb))
    assert view.picture is None or view.picture.level(coarse=False) is view.picture.level(coarse=True) is None


def test_a_point_shows_what_its_pixel_shows_at_both_levels():
    view = View(plate(painted()))
    fine, coarse = view.picture.level(coarse=False), view.picture.level(coarse=True)
    shown = np.stack([fine.shown.T, coarse.shown.T])
    fx, fy, cx, cy = view.intrinsics
    u = np.rint(view.points[:, 0] / view.points[:, 2] * fx + cx).astype(int)
    v = np.rint(view.points[:, 1] / view.points[:, 2] * fy + cy).astype(int)
    known = shown[0] > 0  # unknown at the outline, where the background mixes in
    assert known[:, (u >= 23) & (u < 77) & (v >= 23) & (v < 57)].all()
    np.testing.assert_allclose(shown[0][known], fine.values[v, u].T[known], atol=1e-3)
    both = (shown[0] > 0) & (shown[1] > 0)
    assert both.mean() > 0.5
    ratios = both & (np.arange(3) != LIGHT)[:, None]  # brightness is that above wider surroundings there
    assert np.abs(shown[0] - shown[1])[ratios].mean() < 0.5 * shown[0][ratios].std()
    assert np.abs(fine.values[30:50, 30:70] - KNOWN).max() < 2
    assert coarse.values.shape[:2] == (SHAPE[0] // COARSE, SHAPE[1] // COARSE)


def test_thinned_views_keep_their_colours():
    view = View(plate(painted()))
    for coarse in (False, True):
        thin = view.thinned(4).picture.level(coarse).shown
        np.testing.assert_array_equal(thin, view.picture.level(coarse).shown[::4])


def barrel():
    """Normals (h, w, 3) of an upright cylinder that fills the image, and where a mark is printed on it."""
    across = np.linspace(-0.97, 0.97, SHAPE[1])
    normals = np.zeros((*SHAPE, 3), np.float32)
    normals[..., 0], normals[..., 2] = across, -np.sqrt(1 - across**2)
    mark = np.zeros(SHAPE, bool)
    mark[30:45, 35:60] = True
    return normals, mark


def test_shade_and_highlights_are_taken_out_of_brightness_and_marks_are_left():
    normals, mark = barrel()
    facing = normals @ np.array([-0.6, 0.0, -0.8], np.float32)
    lit = np.log(0.2 + np.clip(facing, 0, 1) + 2 * np.clip(facing, 0, 1) ** 60)
    light = (KNOWN + lit - 2.0 * mark).astype(np.float32)
    unshade(light, np.ones(SHAPE, np.float32), normals)
    assert np.abs(light[~mark] - KNOWN).mean() < 0.1 * lit.std()
    np.testing.assert_allclose(light[mark].mean(), KNOWN - 2, atol=0.3)


def test_directions_in_which_the_sensor_saturates_say_nothing():
    normals, mark = barrel()
    light = np.where(mark, KNOWN - 2, KNOWN + 1).astype(np.float32)
    light[:, 45:55] = np.where(mark, KNOWN - 2, 0)[:, 45:55]
    unshade(light, np.ones(SHAPE, np.float32), normals)
    np.testing.assert_allclose(light[30:45, 35:38], light[32, 36], atol=0.1)
    assert abs(light[32, 36] - KNOWN) > 1
    assert (light[32, 46:54] == KNOWN).all()


def test_black_and_white_marks_make_a_picture():
    rgb = np.full((*SHAPE, 3), 180, np.uint8)
    rgb[34:44, 40:52] = 30
    for coarse in (False, True):
        level = View(plate(rgb)).picture.level(coarse)
        assert np.ptp(level.shown[level.shown[:, LIGHT] > 0][:, LIGHT]) > 0.5
        known = level.values[..., LIGHT] > 0
        assert np.ptp(level.values[..., 0][known]) < 1e-3
