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

"""Folders of depth images to bags: a small made one for every case, the real recording for the whole."""

import numpy as np
import pytest
from PIL import Image

from debris_scanner.cli.main import main
from debris_scanner.core.geometry import exp_so3, inverse, transform
from debris_scanner.io.mesh_files import read_cloud
from debris_scanner.io.trajectories import read_tum
from msg_adapters.bags import open_session

FX, FY, CX, CY = 100.0, 101.0, 31.5, 23.5
WIDTH, HEIGHT = 64, 48
FRAMES = 12  # two digits: alphabetical order is not the frames' order


def pose(k):
    """T_target_sensor: the camera moves along x and turns a little."""
    return transform(exp_so3(np.array([0.0, 0.01 * k, 0.0])), np.array([0.005 * k, 0.02, -0.5]))


@pytest.fixture
def folder(tmp_path):
    """Depth images of the plane z = 0 of the target's frame, with stretched poses as in the real set."""
    root = tmp_path / 'made'
    for name in ('depth', 'color', 'poses'):
        (root / name).mkdir(parents=True)
    (root / 'Intrinsic.txt').write_text(f'{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1')
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - CX) / FX, (v - CY) / FY, np.ones_like(u, float)], axis=-1)
    for k in range(FRAMES):
        T = pose(k)
        depth = -T[2, 3] / (rays @ T[2, :3])
        Image.fromarray(np.rint(depth * 1000).astype(np.uint16)).save(root / 'depth' / f'depth_{k}.png')
        Image.fromarray(np.full((HEIGHT, WIDTH, 3), 10 * k, np.uint8)).save(root / 'color' / f'color_{k}.png')
        T[:3, :3] = T[:3, :3] @ np.diag([1.0, 0.9957, 0.9957])
        np.savetxt(root / 'poses' / f'poses_{k}.txt', T)
    return root


def run(folder, out, *options):
    return main(['import', str(folder), '--out', str(out), *options])


def refused(capsys, folder, out, *options):
    """The one line that refuses a folder, of which nothing may be left behind."""
    assert run(folder, out, *options) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith('debris-scan import: ')
    assert sorted(out.parent.iterdir()) == [folder]
    return line


def test_frames_come_in_the_order_of_their_numbers(folder, tmp_path):
    assert run(folder, tmp_path / 'bag', '--rate', '10') == 0
    with open_session(tmp_path / 'bag') as session:
        frames = list(session)
    assert [stamp for stamp, _ in frames] == [10**9 + k * 10**8 for k in range(FRAMES)]
    for k, (stamp, frame) in enumerate(frames):
        assert frame.stamp_ns == stamp
        written = np.asarray(Image.open(folder / 'depth' / f'depth_{k}.png'))
        np.testing.assert_allclose(frame.depth, written * 1e-3, atol=1e-6)
        assert (frame.camera.fx, frame.camera.fy, frame.camera.cx, frame.camera.cy) == (FX, FY, CX, CY)


def test_truth_is_the_pose_of_the_target_and_the_surface_seen(folder, tmp_path):
    assert run(folder, tmp_path / 'bag') == 0
    poses = read_tum(tmp_path / 'bag' / 'truth.tum')
    assert [p.stamp_ns for p in poses] == [10**9 + k * 2 * 10**8 for k in range(FRAMES)]
    for k, p in enumerate(poses):
        np.testing.assert_allclose(p.T_sensor_target, inverse(pose(k)), atol=1e-6)
    cloud = read_cloud(tmp_path / 'bag' / 'truth_cloud.ply')
    assert len(cloud) > 1000
    assert np.abs(cloud[:, 2]).max() < 5e-4
    assert np.ptp(cloud[:, 0]) > 0.25


def test_without_poses_there_is_no_truth(folder, tmp_path, capsys):
    (folder / 'poses').rename(folder / 'other')
    assert run(folder, tmp_path / 'bag') == 0
    assert not list((tmp_path / 'bag').glob('truth*'))
    assert 'no truth' in capsys.readouterr().out


def test_colour_travels_as_clouds(folder, tmp_path):
    assert run(folder, tmp_path / 'bag', '--colour') == 0
    with open_session(tmp_path / 'bag') as session:
        assert session.topic == '/points'
        for k, (_, frame) in enumerate(session):
            assert np.unique(frame.rgb[frame.depth > 0]).tolist() == [10 * k]


def test_images_may_lie_in_the_folder_itself(folder, tmp_path):
    for path in (folder / 'depth').iterdir():
        path.rename(folder / path.name)
    (folder / 'depth').rmdir()
    assert run(folder, tmp_path / 'bag') == 0
    with open_session(tmp_path / 'bag') as session:
        assert session.count == FRAMES


def test_missing_intrinsics(folder, tmp_path, capsys):
    (folder / 'Intrinsic.txt').unlink()
    assert 'Intrinsic.txt' in refused(capsys, folder, tmp_path / 'bag')


@pytest.mark.parametrize('text', ['1 2 3', '0 0 1 0 0 1 0 0 1', 'a b c d e f g h i', 'nan ' * 9])
def test_unusable_intrinsics(folder, tmp_path, capsys, text):
    (folder / 'Intrinsic.txt').write_text(text)
    assert 'Intrinsic.txt' in refused(capsys, folder, tmp_path / 'bag')


def test_no_images(folder, tmp_path, capsys):
    for path in (folder / 'depth').iterdir():
        path.unlink()
    assert 'no depth images' in refused(capsys, folder, tmp_path / 'bag')


def test_not_a_folder(folder, tmp_path, capsys):
    assert run(folder / 'nowhere', tmp_path / 'bag') == 2
    assert 'nowhere does not exist' in capsys.readouterr().err
    assert run(folder / 'Intrinsic.txt', tmp_path / 'bag') == 2
    assert 'Intrinsic.txt is not a folder' in capsys.readouterr().err


def test_eight_bit_image(folder, tmp_path, capsys):
    Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8)).save(folder / 'depth' / 'depth_5.png')
    line = refused(capsys, folder, tmp_path / 'bag')
    assert 'depth_5.png' in line
    assert '16-bit' in line


def test_unequal_sizes(folder, tmp_path, capsys):
    Image.fromarray(np.zeros((HEIGHT, WIDTH // 2), np.uint16)).save(folder / 'depth' / 'depth_3.png')
    line = refused(capsys, folder, tmp_path / 'bag')
    assert 'depth_3.png is 32 x 48' in line


def test_broken_image(folder, tmp_path, capsys):
    path = folder / 'depth' / 'depth_7.png'
    path.write_bytes(path.read_bytes()[:60])
    assert 'depth_7.png' in refused(capsys, folder, tmp_path / 'bag')


def test_missing_pose(folder, tmp_path, capsys):
    (folder / 'poses' / 'poses_4.txt').unlink()
    assert 'no pose for depth_4.png (1 of 12 missing)' in refused(capsys, folder, tmp_path / 'bag')


def test_pose_that_is_no_rotation(folder, tmp_path, capsys):
    np.savetxt(folder / 'poses' / 'poses_4.txt', np.diag([1.0, 1.0, -1.0, 1.0]))
    assert 'poses_4.txt is no rigid transform' in refused(capsys, folder, tmp_path / 'bag')


def test_colour_without_colour_images(folder, tmp_path, capsys):
    (folder / 'color').rename(folder / 'other')
    assert 'no colour images' in refused(capsys, folder, tmp_path / 'bag', '--colour')


def test_two_images_of_one_number(folder, tmp_path, capsys):
    Image.open(folder / 'depth' / 'depth_3.png').save(folder / 'depth' / 'depth_03.png')
    assert 'same number' in refused(capsys, folder, tmp_path / 'bag')


@pytest.mark.parametrize('rate', ['0', '-1', 'nan', 'inf', 'fast'])
def test_rate_must_be_positive(folder, tmp_path, capsys, rate):
    with pytest.raises(SystemExit) as ended:
        run(folder, tmp_path / 'bag', '--rate', rate)
    assert ended.value.code == 2
    assert rate in capsys.readouterr().err


def test_existing_bag_is_left_alone(folder, tmp_path, capsys):
    assert run(folder, tmp_path / 'bag') == 0
    before = {p.name: p.stat().st_mtime_ns for p in (tmp_path / 'bag').iterdir()}
    assert run(folder, tmp_path / 'bag') == 2
    assert 'exists already' in capsys.readouterr().err
    assert {p.name: p.stat().st_mtime_ns for p in (tmp_path / 'bag').iterdir()} == before


@pytest.mark.slow
def test_real_recording(bunny_bag):
    poses = read_tum(bunny_bag / 'truth.tum')
    assert len(poses) == 36
    cloud = read_cloud(bunny_bag / 'truth_cloud.ply')
    # a printed bunny of 15 cm
    assert 0.14 < np.ptp(cloud, axis=0).max() < 0.16
    with open_session(bunny_bag) as session:
        frames = [frame for _, frame in session]
    assert len(frames) == 36
    # what a frame saw lies on the truth where that frame's pose puts the truth
    from scipy.spatial import cKDTree

    tree = cKDTree(cloud)
    for frame, p in list(zip(frames, poses, strict=True))[::7]:
        seen = frame.camera.back_project(frame.depth)[frame.depth > 0]
        T = inverse(p.T_sensor_target)
        assert np.median(tree.query(seen @ T[:3, :3].T + T[:3, 3])[0]) < 7e-4


def times(root):
    """Rename the frames to the times at which they were taken: 7 Hz."""
    for k in range(FRAMES):
        name = f'{1305031102.96 + k / 7:.6f}'
        (root / 'depth' / f'depth_{k}.png').rename(root / 'depth' / f'{name}.png')
        (root / 'color' / f'color_{k}.png').rename(root / 'color' / f'{name}.png')
    (root / 'poses').rename(root.parent / 'poses')
    return root


def test_stamps_of_the_names_are_used_and_a_rate_takes_their_place(folder, tmp_path):
    times(folder)
    for options, first_ns, step_ns in (((), 1305031102_960_000_000, 1 / 7), (('--rate', '4'), 10**9, 0.25)):
        out = tmp_path / str(len(options))
        assert run(folder, out, *options) == 0
        with open_session(out) as session:
            stamps = [stamp for stamp, _ in session]
        assert stamps[0] == first_ns
        np.testing.assert_allclose(np.diff(stamps), 1e9 * step_ns, atol=2000)


def test_colour_of_the_same_pixels_comes_along(folder, tmp_path):
    assert run(folder, tmp_path / 'bag') == 0
    with open_session(tmp_path / 'bag') as session:
        assert (session.topic, session.colour_topic) == ('/depth/image_raw', '/rgb/image_raw')
        assert [int(frame.rgb[0, 0, 0]) for _, frame in session] == [10 * k for k in range(FRAMES)]


def test_a_finer_unit_than_a_millimetre_is_kept(folder, tmp_path):
    assert run(folder, tmp_path / 'bag', '--depth-scale', '0.0002') == 0
    with open_session(tmp_path / 'bag') as session:
        _, frame = next(iter(session))
    written = np.asarray(Image.open(folder / 'depth' / 'depth_0.png'))
    np.testing.assert_allclose(frame.depth, written * 2e-4, atol=1e-7)


def test_intrinsics_may_be_given(folder, tmp_path):
    (folder / 'Intrinsic.txt').unlink()
    assert run(folder, tmp_path / 'bag', '--intrinsics', f'{FX},{FY},{CX},{CY}') == 0
    with open_session(tmp_path / 'bag') as session:
        assert next(iter(session))[1].camera.fx == FX


@pytest.mark.parametrize(
    ('options', 'named'),
    [
        (('--intrinsics', '1,2,3'), '1,2,3 is not FX,FY,CX,CY'),
        (('--intrinsics', '0,2,3,4'), '0,2,3,4 is not FX,FY,CX,CY'),
        (('--depth-scale', '0'), '0 is no number of metres a unit'),
        (('--axes=x,x,z',), 'are no axes of a right-handed frame'),
    ],
)
def test_options_that_cannot_be_are_named(folder, tmp_path, capsys, options, named):
    with pytest.raises(SystemExit) as ended:
        run(folder, tmp_path / 'bag', *options)
    assert ended.value.code == 2
    assert named in capsys.readouterr().err


def test_a_bag_of_another_recorder_becomes_one_of_ours(shared_data, tmp_path, capsys):
    source = shared_data / 'real' / 'bags' / 'librealsense_sdk' / 'single_depth_color_640x480.bag'
    if not source.is_file():
        pytest.skip(f'no {source}')
    assert run(source, tmp_path / 'bag') == 0
    assert 'colour of /device_0/sensor_1/Color_0/image/data is not used' in capsys.readouterr().out
    with open_session(source) as theirs, open_session(tmp_path / 'bag') as ours:
        assert ours.topic == '/depth/image_raw'
        for (stamp, a), (again, b) in zip(theirs, ours, strict=True):
            assert stamp == again
            np.testing.assert_array_equal(a.depth, b.depth)


def test_clouds_come_as_clouds(shared_data, tmp_path):
    source = shared_data / 'real' / 'dragon_stand'
    if not source.is_dir():
        pytest.skip(f'no {source}')
    assert run(source, tmp_path / 'bag', '--axes=x,-y,0.7-z') == 0
    with open_session(tmp_path / 'bag') as session:
        assert session.topic == '/points'
        assert session.count == 15
        _, frame = next(iter(session))
    assert 0.5 < np.median(frame.depth[frame.depth > 0]) < 0.8
    assert len(read_tum(tmp_path / 'bag' / 'truth.tum')) == 15
