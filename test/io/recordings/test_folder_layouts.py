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

"""Recordings as people have them: a small made one of each layout, and the real ones where they are."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import apply, exp_so3, inverse, to_quaternion, transform
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.recordings.layouts import open_recording
from debris_scanner.io.recordings.recording import Given, RecordingError
from debris_scanner.sensing.cloud_axes import parse_axes

CAMERA = Camera(100.0, 101.0, 31.5, 23.5, 64, 48)
INTRINSICS = (100.0, 101.0, 31.5, 23.5)
FRAMES = 6
TIMES = ['1305031102.96', '1305031103.025', '1305031103.5', '1305031104.1', '1305031104.6', '1305031105.1']
NS = [round(float(t) * 1000) * 10**6 for t in TIMES]


def depth(k):
    """Metres (h, w): a plane whose distance tells the frame."""
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    return 0.5 + 0.02 * k + 0.001 * u + 0.0005 * v


def png(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(values).save(path)


def depth_png(path, k, units=1000.0):
    png(path, np.rint(depth(k) * units).astype(np.uint16))


def colour_png(path, k):
    png(path, np.full((48, 64, 3), 20 * k + 5, np.uint8))


def pose(k):
    """T_room_camera."""
    return transform(exp_so3(np.array([0.0, 0.05 * k, 0.01])), np.array([0.01 * k, 0.0, 0.2]))


def check(recording, tolerance=6e-4, colour=True):
    """That all frames are in order, of the right scale, and each has its own colour."""
    assert recording.count == FRAMES
    for k in range(FRAMES):
        frame = recording.read(k, 10**9 + k)
        assert frame.stamp_ns == 10**9 + k
        assert frame.camera == CAMERA
        np.testing.assert_allclose(frame.depth, depth(k), atol=tolerance)
        assert (frame.rgb is not None) == colour
        if colour:
            assert (frame.rgb == 20 * k + 5).all()


def write_matrix(folder):
    np.savetxt(folder / 'Intrinsic.txt', [[100, 0, 31.5], [0, 101, 23.5], [0, 0, 1]])


def test_names_that_are_times_are_sorted_as_such_and_pair_the_colour(tmp_path):
    """Sorted by the last number, the fraction of the second, these would be 0, 3, 4, 1, 2 and so on."""
    for k, time in enumerate(TIMES):
        depth_png(tmp_path / 'depth' / f'{time}.png', k)
        colour_png(tmp_path / 'rgb' / f'{float(time) + 0.02:.6f}.png', k)
    write_matrix(tmp_path)
    recording = open_recording(tmp_path, Given())
    check(recording)
    assert recording.stamps_ns == NS


@pytest.mark.parametrize('digits', [13, 16, 19])
def test_long_counts_since_1970_are_times(tmp_path, digits):
    for k, ns in enumerate(NS):
        depth_png(tmp_path / f'{str(ns)[:digits]}.png', k)
    write_matrix(tmp_path)
    assert open_recording(tmp_path, Given()).stamps_ns == NS


def test_times_and_numbers_are_not_mixed(tmp_path):
    for name in ('1.5', '2.5', 'extra_3'):
        depth_png(tmp_path / f'{name}.png', 0)
    write_matrix(tmp_path)
    with pytest.raises(RecordingError, match=r'extra_3\.png is no time, as the names of other files'):
        open_recording(tmp_path, Given())


def test_a_frame_without_colour_near_in_time_has_none(tmp_path):
    for k, time in enumerate(TIMES):
        depth_png(tmp_path / 'depth' / f'{time}.png', k)
    colour_png(tmp_path / 'color' / f'{TIMES[2]}.png', 2)
    write_matrix(tmp_path)
    recording = open_recording(tmp_path, Given())
    assert [recording.read(k, 1).rgb is not None for k in range(3)] == [False, False, True]


def test_masks_choose_the_target(tmp_path):
    for k in range(FRAMES):
        depth_png(tmp_path / 'depth' / f'{k}.png', k)
        mask = np.zeros((48, 64), np.uint8)
        mask[10:20, 5 + k : 30] = 255
        png(tmp_path / 'masks' / f'{k}.png', mask)
    write_matrix(tmp_path)
    recording = open_recording(tmp_path, Given())
    for k in range(FRAMES):
        seen = recording.read(k, 1).depth > 0
        assert seen.sum() == 10 * (25 - k)
        assert seen[10:20, 5 + k : 30].all()
    assert recording.remarks == ['6 masks choose the target']


def test_colour_of_another_size_is_left_out_and_said(tmp_path):
    for k in range(FRAMES):
        depth_png(tmp_path / 'depth' / f'{k}.png', k)
        png(tmp_path / 'color' / f'{k}.png', np.zeros((96, 128, 3), np.uint8))
    write_matrix(tmp_path)
    recording = open_recording(tmp_path, Given())
    check(recording, colour=False)
    assert 'is 128 x 96 pixels, the depth is 64 x 48: not registered' in recording.remarks[0]


def open3d(folder, name='camera_intrinsic.json', **more):
    for k in range(FRAMES):
        depth_png(folder / 'depth' / f'{k:06d}.png', k, more.get('depth_scale', 1000))
        folder.joinpath('color').mkdir(exist_ok=True)
        Image.fromarray(np.full((48, 64, 3), 20 * k + 5, np.uint8)).save(
            folder / 'color' / f'{k:06d}.jpg', quality=100
        )
    columns = [100.0, 0.0, 0.0, 0.0, 101.0, 0.0, 31.5, 23.5, 1.0]
    (folder / name).write_text(json.dumps({'width': 64, 'height': 48, 'intrinsic_matrix': columns} | more))
    return folder


def test_what_open3ds_recorder_writes(tmp_path):
    check(open_recording(open3d(tmp_path), Given()))


def test_open3ds_depth_scale_counts_units_a_metre(tmp_path):
    recording = open_recording(open3d(tmp_path, 'intrinsic.json', depth_scale=4000.0), Given())
    check(recording, 2e-4)
    assert recording.unit == 1 / 4000
    np.testing.assert_allclose(
        open_recording(tmp_path, Given(depth_scale=0.001)).read(0, 1).depth, 4 * depth(0), atol=1e-3
    )


def tum(folder):
    """As the benchmark packs it: lists of times and files, comments, poses of another rate."""
    rows = {'depth': [], 'rgb': []}
    for k, time in enumerate(TIMES):
        depth_png(folder / 'depth' / f'{time}.png', k, 5000)
        rows['depth'].append(f'{time} depth/{time}.png')
        late = f'{float(time) + 0.013:.6f}'
        colour_png(folder / 'rgb' / f'{late}.png', k)
        rows['rgb'].append(f'{late} rgb/{late}.png')
    for name, lines in rows.items():
        (folder / f'{name}.txt').write_text('# a comment\n' + '\n'.join(lines) + '\n')
    truth = []
    for time in np.arange(float(TIMES[0]) - 0.5, float(TIMES[-1]) - 0.2, 0.01):
        s = time - float(TIMES[0])
        T = pose(s)
        numbers = [*T[:3, 3], *to_quaternion(T[:3, :3])]
        truth.append(f'{time:.4f} ' + ' '.join(f'{x:.9f}' for x in numbers))
    (folder / 'groundtruth.txt').write_text('# tx ty tz qx qy qz qw\n' + '\n'.join(truth))
    return folder


def test_a_tum_sequence(tmp_path):
    recording = open_recording(tum(tmp_path), Given(intrinsics=INTRINSICS))
    check(recording, 2e-4)
    assert recording.stamps_ns == NS
    for k in range(FRAMES - 1):
        np.testing.assert_allclose(recording.poses[k], pose((NS[k] - NS[0]) * 1e-9), atol=2e-4)
    assert recording.poses[-1] is None  # its time is not in the file


def test_a_tum_sequence_asks_for_its_intrinsics(tmp_path):
    with pytest.raises(RecordingError, match=r'no intrinsics: give --intrinsics FX,FY,CX,CY; .*525,525'):
        open_recording(tum(tmp_path), Given())


@pytest.mark.parametrize(
    ('name', 'text', 'why'),
    [
        ('depth.txt', '', 'names no files'),
        ('depth.txt', '1.0\n', 'has a line that is not a time'),
        ('depth.txt', '1.0 depth/none.png', 'which is not there'),
        ('depth.txt', 'soon depth/none.png\n', "'soon' is no time"),
        ('groundtruth.txt', '1.0 2 3\n2.0 3 4\n', 'does not hold lines of t tx'),
        ('groundtruth.txt', '1.0 2 3 4 0 0 0 0\n2.0 2 3 4 0 0 0 0\n', 'does not hold lines of t tx'),
    ],
)
def test_a_broken_list_of_tums_is_named(tmp_path, name, text, why):
    tum(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=why):
        open_recording(tmp_path, Given(intrinsics=INTRINSICS))


def bop(folder, objects=(5,)):
    cameras, truth = {}, {}
    for k in range(FRAMES):
        depth_png(folder / 'depth' / f'{k:06d}.png', k, 10_000)
        colour_png(folder / 'rgb' / f'{k:06d}.png', k)
        cameras[str(k)] = {'cam_K': [100, 0, 31.5, 0, 101, 23.5, 0, 0, 1], 'depth_scale': 0.1}
        truth[str(k)] = []
        for n, number in enumerate(objects):
            T = inverse(pose(k + 10 * n))
            truth[str(k)].append(
                {
                    'obj_id': number,
                    'cam_R_m2c': T[:3, :3].ravel().tolist(),
                    'cam_t_m2c': (1000 * T[:3, 3]).tolist(),
                }
            )
            mask = np.zeros((48, 64), np.uint8)
            mask[10 * n : 10 * n + 5 + k] = 255
            png(folder / 'mask_visib' / f'{k:06d}_{n:06d}.png', mask)
    (folder / 'scene_camera.json').write_text(json.dumps(cameras))
    (folder / 'scene_gt.json').write_text(json.dumps(truth))
    return folder


def test_a_bop_scene_of_one_object(tmp_path):
    recording = open_recording(bop(tmp_path), Given())
    for k in range(FRAMES):
        frame = recording.read(k, 1)
        rows = 5 + k
        np.testing.assert_allclose(frame.depth[:rows], depth(k)[:rows], atol=6e-5)
        assert not frame.depth[rows:].any()
        np.testing.assert_allclose(recording.poses[k], pose(k), atol=1e-6)
    assert recording.unit == pytest.approx(1e-4)


def test_a_bop_scene_of_several_asks_which(tmp_path):
    bop(tmp_path, (5, 8))
    with pytest.raises(RecordingError, match=r'shows 2 objects \(5, 8\): choose one by --target'):
        open_recording(tmp_path, Given())
    recording = open_recording(tmp_path, Given(target='8'))
    assert np.flatnonzero(recording.read(0, 1).depth.any(axis=1)).tolist() == [10, 11, 12, 13, 14]
    np.testing.assert_allclose(recording.poses[3], pose(13), atol=1e-6)


def test_where_a_bop_target_is_hidden_there_is_no_depth(tmp_path):
    bop(tmp_path)
    truth = json.loads((tmp_path / 'scene_gt.json').read_text())
    truth['2'] = []
    (tmp_path / 'scene_gt.json').write_text(json.dumps(truth))
    recording = open_recording(tmp_path, Given())
    assert not recording.read(2, 1).depth.any()
    assert recording.poses[2] is None


def test_a_folder_of_bop_scenes_asks_for_one(tmp_path):
    (tmp_path / '000001').mkdir()
    bop(tmp_path / '000001')
    with pytest.raises(RecordingError, match=r'1 scenes of BOP: name one, such as .*000001'):
        open_recording(tmp_path, Given())


def write_cloud(path, points, organised=None):
    """A cloud as Open3D writes it; a PCD made organised by its header."""
    o3d = load_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.reshape(-1, 3).astype(float)))
    assert o3d.io.write_point_cloud(str(path), cloud, write_ascii=True)
    if organised is not None:
        height, width = organised
        text = path.read_text().replace('HEIGHT 1\n', f'HEIGHT {height}\n')
        path.write_text(text.replace(f'WIDTH {height * width}\n', f'WIDTH {width}\n'))


def points_of(k):
    return CAMERA.back_project(depth(k).astype(np.float32))


def test_an_organised_pcd_keeps_its_rows_and_so_its_camera(tmp_path):
    for k in range(3):
        write_cloud(tmp_path / f'cloud_{k}.pcd', points_of(k), (48, 64))
    recording = open_recording(tmp_path, Given())
    for k in range(3):
        frame = recording.read(k, 1)
        np.testing.assert_allclose(frame.depth, depth(k), atol=1e-5)
        assert frame.camera.fx == pytest.approx(100, rel=1e-3)


@pytest.mark.parametrize('suffix', ['pcd', 'ply'])
def test_clouds_in_body_axes_ask_for_them_and_take_them(tmp_path, suffix):
    for k in range(3):
        body = points_of(k)[..., [2, 0, 1]] * np.float32([1, -1, -1])
        write_cloud(tmp_path / f'{1.25 + k / 4}.{suffix}', body)
    with pytest.raises(RecordingError, match=r'points lie along \+x: not an optical frame .*--axes'):
        open_recording(tmp_path, Given())
    recording = open_recording(tmp_path, Given(axes=parse_axes('-y,-z,x'), depth_scale=2.0))
    assert recording.stamps_ns == [1_250_000_000, 1_500_000_000, 1_750_000_000]
    points, _ = recording.cloud(1)
    np.testing.assert_allclose(points, 2 * points_of(1).reshape(-1, 3), atol=1e-5)


def test_two_series_without_poses_are_asked_apart(tmp_path):
    for name in ('L_1', 'L_2', 'R_1'):
        write_cloud(tmp_path / f'{name}.ply', points_of(1))
    with pytest.raises(RecordingError, match=r'2 series of clouds \(L_\*, R_\*\), and no poses'):
        open_recording(tmp_path, Given())


@pytest.mark.parametrize(
    ('make', 'why'),
    [
        (lambda folder: None, 'no depth images'),
        (lambda folder: folder.joinpath('readme.txt').write_text('x'), 'no depth images'),
        (lambda folder: folder.joinpath('scene_camera.json').write_text('{'), 'cannot read'),
        (lambda folder: folder.joinpath('camera_intrinsic.json').write_text('[]'), 'holds no JSON object'),
        (lambda folder: folder.joinpath('camera_intrinsic.json').write_text('{}'), 'no intrinsic_matrix'),
        (lambda folder: folder.joinpath('cloud.ply').write_text('x'), 'has a number in its name'),
        (lambda folder: np.savez(folder / 'a.npz', b=np.ones(3)), r'no arrays points_<n>'),
        (lambda folder: folder.joinpath('c_1.ply').write_text('x'), 'holds no points'),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path, make, why):
    make(tmp_path)
    with pytest.raises(RecordingError, match=why) as refusal:
        open_recording(tmp_path, Given())
    assert '\n' not in str(refusal.value)


def test_a_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / 'a.txt').write_text('')
    for path, why in ((tmp_path / 'a.txt', 'is not a folder'), (tmp_path / 'none', 'does not exist')):
        with pytest.raises(RecordingError, match=why):
            open_recording(path, Given())


def aligned(recording, k):
    """Points of a frame in the target's frame, by the recording's own poses."""
    points = recording.cloud(k)[0].reshape(-1, 3)
    return apply(recording.poses[k], points[np.isfinite(points).all(axis=1)])


def test_real_laser_grids_meet_by_their_truth(shared_data):
    folder = real(shared_data, 'dragon_stand')
    recording = open_recording(folder, Given(axes=parse_axes('x,-y,0.7-z')))
    assert recording.count == 15
    meet(aligned(recording, 0), aligned(recording, 1), 0.0006)


def test_real_clouds_of_two_series_follow_each_other_by_their_poses(shared_data):
    folder = real(shared_data, 'kinect2_toys') / 'berrybox'
    recording = open_recording(folder, Given(axes=parse_axes('-x,-y,z')))
    assert recording.count == 18
    steps = [
        np.degrees(np.arccos((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2))
        for a, b in zip(recording.poses, recording.poses[1:], strict=False)
    ]
    assert max(steps) < 12  # not the 45 degrees from one end to the middle
    assert sum(steps) == pytest.approx(90, abs=5)


def real(shared_data, name):
    folder: Path = shared_data / 'real' / name
    if not folder.is_dir():
        pytest.skip(f'no {folder}')
    return folder


def meet(a, b, within):
    """That most of two clouds' overlap lies within a distance."""
    from scipy.spatial import cKDTree

    distance = cKDTree(a).query(b[::20])[0]
    assert np.percentile(distance, 30) < within
