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

"""Hints at what is odd about an input: units, stamps, empty images."""

import contextlib

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, FrameRejected
from debris_scanner.sensing.hints import NO_DEPTH, joined, model_unit, stamp_hint, step_hint, unit_hint
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor

CAMERA = Camera(52.5, 52.5, 31.5, 23.5, 64, 48)
MS = 1_000_000


def images(*depths):
    """A depth image, the target's a square in the middle."""
    depth = np.zeros((48, 64), np.float32)
    depth[14:34, 22:42] = depths[0]
    if len(depths) > 1:
        depth[:10] = depths[1]
    return depth


@pytest.mark.parametrize(
    ('depth', 'hint'),
    [
        (0.8, ''),
        (0.11, ''),
        (19.0, ''),
        (812.0, 'millimetres in a format that is in metres (its median is 812 m)'),
        (4200.0, 'millimetres in a format that is in metres'),
        (0.002, 'metres in a format that is in millimetres (its median is 0.002 m)'),
        (30.2, 'the median depth is 30.2 m, a target is looked for from 0.1 to 20 m'),
        (0.0, NO_DEPTH),
    ],
)
def test_a_unit_is_told_by_where_the_depth_would_lie(depth, hint):
    told = unit_hint(images(depth), 0.1, 20.0)
    assert hint in told
    assert bool(hint) == bool(told)


def a_slope_mm(depths_mm):
    """A depth image of a slope, with noise of 2 mm."""
    noise = np.random.default_rng(1).normal(0, 2, (48, 64))
    return np.tile(depths_mm, (48, 1)) + noise


@pytest.mark.parametrize('range_m', [0.8, 4.0, 7.5])
def test_depths_of_another_unit_are_told_by_their_step(range_m):
    mm = a_slope_mm(np.linspace(1000 * range_m - 40, 1000 * range_m + 40, 64))
    whole = np.rint(mm)
    assert step_hint((1e-3 * whole).astype(np.float32)) == ''
    assert step_hint((1e-3 * mm).astype(np.float32)) == ''  # a lidar's, or a float image
    for step in (5, 8):  # 0.2 mm made of millimetres; bits shifted by three
        coarse = np.where(np.random.default_rng(2).random(mm.shape) < 0.97, whole * step, whole * step + 1)
        assert f'multiples of {step} mm' in step_hint((1e-3 * coarse).astype(np.float32))


def test_few_depths_tell_no_step(preprocessor):
    flat = images(0.8)
    flat[16:20, 24:40] = np.arange(0.8, 0.864, 0.004, np.float32)
    assert step_hint(flat) is None
    preprocessor.process(DepthFrame(0, flat, CAMERA))
    assert preprocessor.unit_warning == ''
    slope = np.float32(8e-3) * np.rint(a_slope_mm(np.linspace(800, 840, 64))).astype(np.float32)
    for stamp_ns, depth in ((1, slope), (2, flat)):
        with contextlib.suppress(FrameRejected):
            preprocessor.process(DepthFrame(stamp_ns, depth, CAMERA))
        assert 'multiples of 8 mm' in preprocessor.unit_warning
    preprocessor.reset()
    assert preprocessor.unit_warning == ''


def test_hints_make_one_line():
    assert joined('', 'a', '', 'b') == 'a; b'
    assert joined() == ''


@pytest.fixture
def preprocessor():
    return Preprocessor(IsolationSettings(), NormalSettings())


def test_a_hint_lasts_until_there_is_a_target(preprocessor):
    with pytest.raises(FrameRejected, match='no_target'):
        preprocessor.process(DepthFrame(5 * MS, images(800.0), CAMERA))
    assert 'millimetres' in joined(*preprocessor.hints)
    preprocessor.process(DepthFrame(6 * MS, images(0.8), CAMERA))
    assert preprocessor.hints == ()
    with pytest.raises(FrameRejected):  # it has left, and a wall is seen
        preprocessor.process(DepthFrame(7 * MS, images(30.0), CAMERA))
    assert preprocessor.hints == ()
    preprocessor.reset()
    with pytest.raises(FrameRejected):
        preprocessor.process(DepthFrame(1 * MS, images(30.0), CAMERA))
    assert 'check the unit' in joined(*preprocessor.hints)


@pytest.mark.parametrize('stamp_ns', [0, 5 * MS])
def test_stamps_that_are_all_the_same_are_named(preprocessor, stamp_ns):
    preprocessor.process(DepthFrame(stamp_ns, images(0.8), CAMERA))
    assert preprocessor.hints == ()
    with pytest.raises(FrameRejected, match='non_monotone_stamp'):
        preprocessor.process(DepthFrame(stamp_ns, images(0.8), CAMERA))
    assert preprocessor.hints == (stamp_hint(stamp_ns),)
    assert f'all stamps are {stamp_ns}: ' in joined(*preprocessor.hints)
    preprocessor.process(DepthFrame(stamp_ns + MS, images(0.8), CAMERA))
    assert preprocessor.hints == ()
    with pytest.raises(FrameRejected, match='non_monotone_stamp'):
        preprocessor.process(DepthFrame(stamp_ns + MS, images(0.8), CAMERA))
    assert preprocessor.hints == ()


@pytest.mark.parametrize(
    ('extent', 'seen', 'unit'),
    [
        (0.3, 0.2, ''),
        (4.0, 1.5, ''),
        (0.3, 0.6, ''),
        (8.0, 0.06, 'centimetres'),
        (15.0, 0.012, 'millimetres'),
        (3.0, 0.07, 'inches'),
    ],
)
def test_the_unit_of_a_model_is_told_by_the_target(extent, seen, unit):
    assert model_unit(extent, seen) == unit
