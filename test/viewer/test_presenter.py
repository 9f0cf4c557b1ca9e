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

"""What is decided from the facts of a scan, drawn into a stand-in for the scene."""

from types import SimpleNamespace

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import compose, exp_se3, inverse
from debris_scanner.viewer.presenter import SCANNING_FRAME, TARGET_FRAME, Placed, ScanPresenter


class Scene:
    """Keeps what was last shown."""

    def __init__(self):
        self.shown, self.readings = {}, {}
        self.panel = SimpleNamespace(
            show_guide=lambda said: self.shown.__setitem__('guide', said),
            show_depth=lambda image, said: self.shown.__setitem__('depth', (image, said)),
            show_end=lambda rows, links: self.shown.__setitem__('end', (rows, links)),
        )

    def __getattr__(self, name):
        return lambda *given: self.shown.__setitem__(name.removeprefix('show_'), given)

    def show_readings(self, values):
        self.readings |= values


@pytest.fixture
def presenter():
    return ScanPresenter(Scene())


def placed(k):
    T = exp_se3(np.array([0.0, 0.1 * k, 0.0, 0, 0, 0]))
    T[2, 3] = 0.8
    return T


def test_key_frames_are_gathered_in_the_targets_frame_whichever_comes_first(presenter):
    points = np.float32([[0.1, 0, 0.9], [0, 0.1, 0.8]])
    normals = np.float32([[0, 0, -1], [0, 0, -1]])
    for k in range(4):
        moved = (points @ placed(k)[:3, :3].T + placed(k)[:3, 3]).astype(np.float32)
        turned = (normals @ placed(k)[:3, :3].T).astype(np.float32)
        if k % 2:
            presenter.add_keyframe(k, moved, turned)
        presenter.follow(k, SCANNING_FRAME, placed(k))
        if not k % 2:
            presenter.add_keyframe(k, moved, turned)
    presenter.refresh()
    frame, seen, _ = presenter.scene.shown['seen']
    assert frame == SCANNING_FRAME
    assert 2 <= len(seen) <= 8
    assert np.abs(seen[:, None] - points[None]).max(axis=2).min(axis=1).max() < 1e-5


def test_a_model_after_the_last_frame_lies_on_the_target(presenter):
    """Its frame is turned against the scan's: by what the key frames have in common."""
    T_target_scan = exp_se3(np.array([0.3, 0.2, 0.1, 0.01, 0.02, 0.03]))
    empty = np.zeros((0, 3), np.float32)
    for k in range(5):
        presenter.follow(k, SCANNING_FRAME, placed(k))
        presenter.add_keyframe(k, empty, empty) if k < 3 else None
    presenter.show_pose(Placed(SCANNING_FRAME, placed(4)), 10.0)
    presenter.place_model([(k, compose(T_target_scan, inverse(placed(k)))) for k in range(3)])
    presenter.conclude({'result': 'model'}, [('result', 'model')], [('/files/report.html', 'report.html')])
    frame, T = presenter.scene.shown['pose']
    assert frame == TARGET_FRAME
    np.testing.assert_allclose(T, compose(placed(4), inverse(T_target_scan)), atol=1e-9)
    assert presenter.scene.shown['end'][1] == [('/files/report.html', 'report.html')]
    assert presenter.scene.shown['guide'].state == 'finished'


def test_another_submap_forgets_what_was_seen(presenter):
    presenter.follow(1, SCANNING_FRAME, placed(1))
    presenter.add_keyframe(1, np.float32([[0, 0, 0.8]]), np.float32([[0, 0, -1]]))
    for state in ('scanning', 'lost', 'scanning'):
        presenter.know(state=state)
        presenter.refresh()
    assert len(presenter.scene.shown['seen'][1]) == 0


@pytest.mark.parametrize(
    ('u0', 'width', 'cut'), [(10, 30, ()), (0, 30, ('left',)), (0, 100, ('left', 'right'))]
)
def test_the_window_is_placed_in_the_image_and_its_borders_noticed(presenter, u0, width, cut):
    image = Camera(100.0, 100.0, 49.5, 39.5, 100, 80)
    depth = np.full((20, width), 0.8, np.float32)
    window = TargetFrame(1, image.crop(u0, 30, width, 20), depth, depth, np.zeros((20, width, 3), np.float32))
    presenter.show_window(window, image)
    picture, said = presenter.scene.shown['depth']
    assert picture.shape == (80, 100, 3)
    bright = np.argwhere(picture.max(axis=2) > 34)
    assert bright.min(axis=0).tolist() == [30, u0]
    assert bright.max(axis=0).tolist() == [49, u0 + width - 1]
    assert '0.80 to 0.80 m' in said
    assert presenter.situation.cut == set(cut)
