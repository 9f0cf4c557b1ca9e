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

"""What ``import debris_scanner as ds`` offers: it changes nothing, checks its inputs, and scans."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh

import debris_scanner as ds

CAMERA = ds.Camera(100.0, 100.0, 31.5, 23.5, 64, 48)
MS = 10**6


def depth(metres=1.0):
    return np.full((48, 64), metres, np.float32)


def test_importing_changes_nothing():
    code = (
        'import os, sys; before = dict(os.environ); import debris_scanner as ds;'
        'assert dict(os.environ) == before;'
        'assert not {"numpy", "numba", "scipy"} & set(sys.modules);'
        'ds.Scanner, ds.register, ds.evaluate;'
        'assert dict(os.environ) == before'
    )
    subprocess.run([sys.executable, '-c', code], check=True)


def test_executables_choose_threads_for_themselves():
    code = (
        'import os; os.environ.pop("OPENBLAS_NUM_THREADS", None);'
        'from debris_scanner.cli.main import main\n'
        'try: main(["--version"])\n'
        'except SystemExit: print(os.environ["OPENBLAS_NUM_THREADS"])'
    )
    done = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True, text=True)
    assert done.stdout.split()[-1] == '1'


def test_every_name_is_there():
    assert set(ds.__all__) <= set(dir(ds))
    for name in ds.__all__:
        assert getattr(ds, name) is not None
    with pytest.raises(AttributeError, match='no attribute'):
        _ = ds.Scaner


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'depth': depth().T}, r'shape \(64, 48\).*\(48, 64\): is it transposed'),
        ({'depth': depth()[:40]}, r'shape \(40, 64\)'),
        ({'depth': depth().tolist()}, 'numpy array, not list'),
        ({'depth': depth().astype(np.float16)}, 'not float16'),
        ({'depth': depth().astype(np.int32)}, 'not int32'),
        ({'depth': depth(1000.0)}, 'floats are metres; give millimetres as uint16'),
        ({'stamp_ns': 1.5}, r'whole nanoseconds, not 1\.5 \(float\)'),
        ({'stamp_ns': float('nan')}, 'not nan'),
        ({'stamp_ns': '7'}, "not '7'"),
        ({'colour': np.zeros((24, 32, 3), np.uint8)}, r'\(24, 32, 3\).*register the two'),
        ({'colour': np.zeros((48, 64, 3), np.float32)}, 'of uint8, not an array of float32'),
        ({'camera': (100.0, 100.0)}, 'a Camera, not tuple'),
    ],
)
def test_a_frame_that_is_not_one_is_named_and_does_not_count(given, message):
    scanner = ds.Scanner()
    with pytest.raises(ValueError, match=message) as caught:
        scanner.add(**({'depth': depth(), 'camera': CAMERA, 'stamp_ns': 5} | given))
    assert len(str(caught.value).splitlines()) == 1
    assert scanner.finish().frames_read == 0


@pytest.mark.parametrize('stamps', [(5 * MS, 5 * MS), (9 * MS, 5 * MS), (1, 2), (33, 66)])
def test_stamps_increase_and_are_nanoseconds(stamps):
    scanner = ds.Scanner()
    scanner.add(depth(), CAMERA, stamps[0])
    with pytest.raises(ValueError, match='must increase, and be nanoseconds'):
        scanner.add(depth(), CAMERA, stamps[1])


@pytest.mark.parametrize('kind', [np.float32, np.float64, np.uint16, '>u2', '>f4'])
def test_all_units_of_depth_are_one_image(kind):
    image = np.arange(48 * 64).reshape(48, 64) % 2000
    given = image.astype(kind) if np.dtype(kind).kind == 'u' else (image / 1000).astype(kind)
    frame = ds.DepthFrame(1, given, CAMERA)
    assert frame.depth.dtype == np.float32
    assert frame.depth.flags.c_contiguous
    np.testing.assert_allclose(frame.depth, image / 1000, rtol=1e-6)


def test_what_is_no_number_is_no_depth():
    image = depth()
    image[0, :3] = np.nan, np.inf, -np.inf
    frame = ds.DepthFrame(1, image, CAMERA, np.full((48, 64), 7, np.uint8))
    assert frame.depth[0, :4].tolist() == [0, 0, 0, 1]
    assert np.isnan(image[0, 0])  # the caller's array stays as it is
    assert frame.rgb.shape == (48, 64, 3)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ((0.0, 1, 1, 1, 4, 4), 'focal'),
        ((1, 1, float('nan'), 1, 4, 4), 'principal point'),
        ((1, 1, 1, 1, 4.5, 4), 'width must be a positive whole number'),
        ((1, 1, 1, 1, 4, 0), 'height must be a positive whole number'),
    ],
)
def test_a_camera_that_is_none_is_named(values, message):
    with pytest.raises(ValueError, match=message):
        ds.Camera(*values)


def test_nothing_is_added_to_a_finished_scan():
    scanner = ds.Scanner()
    assert not scanner.finish()
    with pytest.raises(ValueError, match='finished'):
        scanner.add(depth(), CAMERA, 1)
    scanner.reset()
    assert scanner.add(depth(), CAMERA, 1).T_sensor_target is None  # a wall that fills the image


def test_a_loss_and_what_follows_is_told(recording):
    scanner, black = ds.Scanner(), np.zeros((480, 640), np.uint16)
    frames = recording.frames
    step = frames[1].stamp_ns - frames[0].stamp_ns
    for frame in frames[:4]:
        estimate = scanner.add(frame.depth, frame.camera, frame.stamp_ns)
        assert estimate.accepted
        assert estimate.rejected == ''
        np.testing.assert_allclose(estimate.T_sensor_target[3], (0, 0, 0, 1))
    gone = scanner.add(black, frames[0].camera, frames[3].stamp_ns + step)
    assert (gone.accepted, gone.rejected, gone.T_sensor_target) == (False, 'no_target', None)
    result = scanner.finish()
    assert (result.reason, bool(result)) == ('too_few_frames', False)
    (rejected,) = (e for e in scanner.poll() if isinstance(e, ds.ModelRejected))
    assert (rejected.reason, rejected.why) == ('too_few_frames', result.why)
    assert scanner.poll() == []


def test_two_views_are_registered_to_where_the_truth_has_them(recording):
    a, b = (recording.frames[k] for k in (0, 2))
    found = ds.register(a, b)
    assert found
    T_sensor = [recording.truth[f.stamp_ns] for f in (a, b)]
    # a rigid target turns from b to a by this motion, in the sensor's frame
    expected = T_sensor[0] @ np.linalg.inv(T_sensor[1])
    np.testing.assert_allclose(found.T_a_b, expected, atol=0.01)
    assert not np.allclose(found.T_a_b, np.eye(4), atol=0.02)
    again = ds.register(a, b, expected)
    np.testing.assert_allclose(again.T_a_b, found.T_a_b, atol=0.005)


def test_views_that_cannot_be_registered_are_named(recording):
    a = recording.frames[0]
    with pytest.raises(ValueError, match='view b shows no surface: 0 pixels'):
        ds.register(a, ds.DepthFrame(1, np.zeros_like(a.depth), a.camera))
    with pytest.raises(ValueError, match='view a must be a DepthFrame, not ndarray'):
        ds.register(a.depth, a)
    with pytest.raises(ValueError, match='rigid motion'):
        ds.register(a, a, 2 * np.eye(4))
    aside = np.eye(4)
    aside[0, 3] = 5.0
    apart = ds.register(a, a, aside)
    assert (bool(apart), apart.T_a_b) == (False, None)


@pytest.mark.parametrize(
    ('model', 'message'),
    [
        (7, 'not int'),
        (trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False), 'degenerate'),
        (trimesh.creation.box((500, 500, 500)), 'must be in metres'),
        (ds.ScanResult('no_closure', None), 'no model to track: no_closure'),
        ('none.stl', 'not found'),
    ],
)
def test_a_model_that_is_none_is_named(model, message):
    with pytest.raises(ValueError, match=message):
        ds.Tracker(model)


def test_settings_are_checked():
    assert ds.Settings().updated({'fusion.voxel': 1.5}).fusion.voxel == 1.5
    with pytest.raises(ValueError, match='voxels'):
        ds.Settings().updated({'fusion.voxels': 1.5})
    with pytest.raises(ValueError, match=r'none\.yaml'):
        ds.Settings.load('none.yaml')
