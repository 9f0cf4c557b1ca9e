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

"""Target isolation: points in the box, what stands still, and the clusters that make up the target.

Points in the box are those that back-projection puts there, borders included. What stands still is found
within about a second, noise or not, and again once uncovered.
"""

import dataclasses

import numpy as np
import pytest
from synthetic import CAMERA, sphere_depth

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import FrameRejected
from debris_scanner.sensing.isolation import (
    IsolationSettings,
    TargetIsolator,
    mark_box,
)
from debris_scanner.sensing.still_depth import CONFIRMED_S, IN_BOX, STILL, StillDepth

BOX_CAMERA = Camera(50.0, 60.0, 7.5, 5.5, 16, 12)


def marked(depth, camera, low, high):
    """What lies in a box, and which pixels."""
    marks = np.full(depth.shape, STILL, np.uint8)
    whole = (0, depth.shape[0], 0, depth.shape[1])
    seen = mark_box(depth, camera, np.array([low, high]), whole, marks)
    assert set(np.unique(marks)) <= {0, IN_BOX}
    return seen, marks > 0


def test_marked_are_the_points_of_back_projection_that_lie_inside():
    depth = np.random.default_rng(0).uniform(0.1, 1.5, (12, 16)).astype(np.float32)
    depth[3] = 0
    depth[4] = np.nan
    low, high = np.array([-0.05, -0.06, 0.3]), np.array([0.07, 0.08, 1.2])
    seen, marks = marked(depth, BOX_CAMERA, low, high)
    cloud = BOX_CAMERA.back_project(depth)
    inside = ((cloud >= low) & (cloud <= high)).all(axis=-1)
    assert 10 < inside.sum() < 150
    np.testing.assert_array_equal(inside, marks)
    assert seen.pixels == inside.sum()
    rows, columns = np.nonzero(inside)
    assert seen.region == (rows.min(), rows.max() + 1, columns.min(), columns.max() + 1)
    assert (seen.nearest, seen.farthest) == (depth[inside].min(), depth[inside].max())


def test_the_borders_belong_to_the_box():
    depth = np.array([[0.5, 1.0, 1.0000001]], np.float32)
    _, marks = marked(depth, Camera(1.0, 1.0, 0.0, 0.0, 3, 1), np.full(3, 0.0), np.array([9, 9, 1.0]))
    np.testing.assert_array_equal(marks, [[True, True, False]])


STILL_DEPTH_CAMERA = Camera(525.0, 525.0, 20.0, 15.0, 40, 30)
SHAPE = (30, 40)
STEP_NS = 100_000_000


def observe(still, k, depth, camera=STILL_DEPTH_CAMERA):
    """Which pixels of the frame k stand still."""
    marks = np.full(SHAPE, IN_BOX, np.uint8)
    still.observe(camera, (k + 1) * STEP_NS, np.broadcast_to(depth, SHAPE).astype(np.float32), marks)
    return marks & STILL > 0


def test_a_noisy_wall_stands_still_after_about_a_second():
    rng, still = np.random.default_rng(0), StillDepth()
    shares = [observe(still, k, 1.0 + rng.normal(0, 0.0022, SHAPE)).mean() for k in range(25)]
    assert max(shares[: int(CONFIRMED_S * 10) - 1]) == 0
    assert shares[-1] > 0.95
    assert still.observed_s > 2


def test_what_moves_never_does():
    still = StillDepth()
    for k in range(40):
        assert not observe(still, k, 0.8 + 0.05 * np.sin(0.9 * k)).any()


def test_it_is_known_again_after_something_passed_in_front():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0)
    assert not observe(still, 15, 0.7).any()
    assert not observe(still, 16, 0.74).any()
    assert observe(still, 17, 1.0).all()


def test_another_camera_starts_anew():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0)
    other = Camera(525.0, 525.0, 19.0, 15.0, 40, 30)
    assert not observe(still, 15, 1.0, other).any()
    assert still.observed_s == 0


def test_a_camera_fitted_to_each_cloud_is_the_same_camera():
    still = StillDepth()
    for k in range(15):
        observe(still, k, 1.0, dataclasses.replace(STILL_DEPTH_CAMERA, fx=525 + 1e-6 * k, cx=20 - 1e-7 * k))
    assert observe(still, 15, 1.0).all()
    assert not observe(still, 16, 1.0, dataclasses.replace(STILL_DEPTH_CAMERA, fx=570.0, fy=570.0)).any()


SETTINGS = IsolationSettings()
KINECT = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)


def watch(isolator, scenes, camera=CAMERA, after=0):
    """The masks of depth images that follow each other at 10 Hz, or why there is none."""
    masks = []
    for k, depth in enumerate(scenes, start=after + 1):
        try:
            masks.append(isolator.mask(depth, camera, k * STEP_NS))
        except FrameRejected as rejection:
            masks.append(rejection.reason)
    return masks


def together(*depths):
    """The nearest of several depth images."""
    stack = np.stack([np.where(d > 0, d, np.inf) for d in depths])
    nearest = stack.min(axis=0)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def test_mask_is_exactly_the_target():
    depth = sphere_depth()
    mask = TargetIsolator(SETTINGS).mask(depth, CAMERA, STEP_NS)
    np.testing.assert_array_equal(mask, depth > 0)


def swaying(k, centre=(0, 0, 0.6), radius=0.06):
    """A ball that is never long in one place."""
    x, y, z = centre
    return sphere_depth((x + 0.006 * np.sin(1.9 * k), y, z + 0.02 * np.sin(1.3 * k)), radius)


def test_largest_of_several_is_the_target_once_it_is_clear_what_stands_still():
    scenes = [together(swaying(k, (-0.07, 0, 0.6)), swaying(k + 5, (0.19, 0, 0.6), 0.05)) for k in range(20)]
    masks = watch(TargetIsolator(dataclasses.replace(SETTINGS, part_gap=0.0)), scenes)
    assert masks[:10] == ['settling'] * 10
    np.testing.assert_array_equal(masks[-1], swaying(19, (-0.07, 0, 0.6)) > 0)


def in_two(z, gap=0.016):
    """A box of which a strip returns nothing, so that it is seen in two parts."""
    depth = np.zeros((120, 160), np.float32)
    strip = round(gap * CAMERA.fx / z / 2)
    depth[40:80, 40:120] = z
    depth[:, 80 - strip : 80 + strip] = 0
    return depth


def test_a_view_that_moves_as_one_is_not_waited_for():
    """Parts that all move from one frame to the next hold nothing that stands still."""
    moving = [in_two(0.6, 0.16), in_two(0.62, 0.16)]
    masks = watch(TargetIsolator(SETTINGS), moving)
    assert masks[0] == 'settling'
    assert masks[1].any() and not (masks[1] & (moving[1] == 0)).any()
    # one that rests, or that reaches out of the view, may be clutter
    mug = sphere_depth((0.2, 0.1, 0.8), 0.05)
    assert watch(TargetIsolator(SETTINGS), [together(s, mug) for s in moving])[1] == 'settling'
    reaching = [together(s, np.where(CUT_OFF, s.max(), 0)) for s in moving]
    assert watch(TargetIsolator(SETTINGS), reaching)[1] == 'settling'


CUT_OFF = np.zeros((120, 160), np.bool_)
CUT_OFF[:30] = True


def test_looking_back_finds_the_target_where_it_is_seen_later_and_waits_for_nothing():
    """The larger of two things is no target if the target, once seen alone, was the other."""
    small, large = sphere_depth((-0.1, 0, 0.6), 0.04), sphere_depth((0.1, 0, 0.6), 0.06)
    isolator = TargetIsolator(SETTINGS)
    assert watch(isolator, [together(small, large)]) == ['settling']
    assert (watch(isolator, [small], after=1)[0] == (small > 0)).all()
    with isolator.looking_back():
        earlier = isolator.mask(together(small, large), CAMERA, STEP_NS, learn=False)
        assert (isolator.mask(large, CAMERA, 0, learn=False) == (large > 0)).all()
    np.testing.assert_array_equal(earlier, small > 0)
    # what was looked at is not where the target is now
    np.testing.assert_array_equal(watch(isolator, [together(small, large)], after=2)[0], small > 0)


def test_what_stands_still_is_clutter_however_large():
    wall = np.where(sphere_depth((0, 0, 0.6), 0.05) > -1, np.float32(1.1), 0)
    mug = sphere_depth((0.12, 0.03, 0.62), 0.05)
    scenes = [together(wall, mug, swaying(k, (-0.05, 0, 0.6), 0.04)) for k in range(25)]
    isolator = TargetIsolator(SETTINGS)
    masks = watch(isolator, scenes)
    np.testing.assert_array_equal(masks[-1], swaying(24, (-0.05, 0, 0.6), 0.04) > 0)
    assert isolator.still_pixels == ((together(wall, mug) > 0) & ~masks[-1]).sum()


def test_clutter_alone_is_no_target_and_a_still_target_alone_is_one():
    wall = np.where(sphere_depth((0, 0, 0.6), 0.05) > -1, np.float32(1.1), 0)
    assert watch(TargetIsolator(SETTINGS), [wall] * 20)[-1] == 'no_target'
    ball = sphere_depth()
    assert (watch(TargetIsolator(SETTINGS), [ball] * 20)[-1] == (ball > 0)).all()


def test_a_part_that_comes_apart_stays_part_of_the_target():
    isolator = TargetIsolator(SETTINGS)
    body, panel = sphere_depth((-0.1, 0, 0.8), 0.1, KINECT), sphere_depth((0.01, 0, 0.8), 0.02, KINECT)
    apart = sphere_depth((0.07, 0, 0.8), 0.02, KINECT)
    masks = watch(isolator, [together(body, panel), together(body, apart)], KINECT)
    np.testing.assert_array_equal(masks[1], (body > 0) | (apart > 0))
    # what is far off is not
    far = sphere_depth((0.14, 0.06, 1.1), 0.02, KINECT)
    assert (far > 0).sum() > SETTINGS.min_part_pixels
    assert not (watch(isolator, [together(body, far)], KINECT)[0] & (far > 0)).any()


def test_target_stays_the_target_when_something_larger_comes_into_view():
    target, larger = sphere_depth((-0.1, 0, 0.6), 0.05), sphere_depth((0.1, 0, 0.6), 0.07)
    moved = sphere_depth((-0.09, 0.01, 0.6), 0.05)
    masks = watch(TargetIsolator(SETTINGS), [target, together(moved, larger)])
    np.testing.assert_array_equal(masks[1], moved > 0)


def test_a_jump_is_no_continuation():
    isolator = TargetIsolator(SETTINGS)
    isolator.mask(sphere_depth((-0.1, 0, 0.6), 0.05), CAMERA, STEP_NS)
    elsewhere = sphere_depth((0.1, 0, 0.6), 0.06)
    np.testing.assert_array_equal(isolator.mask(elsewhere, CAMERA, STEP_NS), elsewhere > 0)


def test_parts_within_the_gap_belong_together():
    near = together(sphere_depth((-0.05, 0, 0.6), 0.045), sphere_depth((0.05, 0, 0.6), 0.045))  # 10 mm apart
    assert TargetIsolator(SETTINGS).mask(near, CAMERA, STEP_NS).sum() == (near > 0).sum()
    # a finer gap tells them apart
    fine = dataclasses.replace(SETTINGS, cluster_gap=2.0)
    fine = dataclasses.replace(fine, part_gap=0.0)
    assert 0 < watch(TargetIsolator(fine), [near] * 20)[-1].sum() < 0.6 * (near > 0).sum()


@pytest.mark.parametrize(
    ('axis', 'depth'),
    [
        (0, sphere_depth((0.15, 0.0, 0.6), 0.08)),
        (1, sphere_depth((0.0, 0.1, 0.6), 0.08)),
        (2, sphere_depth((0.0, 0.0, 0.6), 0.08)),
    ],
)
def test_what_lies_outside_the_box_is_not_seen(axis, depth):
    v, u = np.nonzero(depth)
    z = depth[v, u]
    points = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z])
    middle = float(np.median(points[axis]))
    for side in ('box_min', 'box_max'):
        corner = list(getattr(SETTINGS, side))
        corner[axis] = middle
        settings = dataclasses.replace(SETTINGS, **{side: tuple(corner)})
        kept = np.zeros_like(depth, bool)
        beyond = points[axis] >= middle if side == 'box_min' else points[axis] <= middle
        kept[v[beyond], u[beyond]] = True
        # it comes closer, or it would be clutter: what is cut by the box and stands still
        mask = watch(TargetIsolator(settings), [depth - np.float32(0.02 * (k % 2)) for k in range(21)])[-1]
        assert (mask & ~kept).sum() == 0
        assert mask.sum() > 0.95 * kept.sum()


@pytest.mark.parametrize(
    'depth', [np.zeros((120, 160), np.float32), sphere_depth((0, 0, 0.6), 0.01), sphere_depth((0, 0, 25), 4)]
)
def test_nothing_large_enough_in_the_box_is_no_target(depth):
    with pytest.raises(FrameRejected) as rejected:
        TargetIsolator(SETTINGS).mask(depth, CAMERA, STEP_NS)
    assert rejected.value.reason == 'no_target'


def test_many_specks_are_no_target():
    depth = np.zeros((480, 640), np.float32)
    depth[10::40, 10::40] = 0.7
    depth[11::40, 10::40] = 0.7
    depth[10::40, 11::40] = 0.7
    specks = dataclasses.replace(SETTINGS, min_pixels=100)
    with pytest.raises(FrameRejected, match='largest cluster'):
        TargetIsolator(specks).mask(depth, KINECT, STEP_NS)


def test_recorded_target_is_isolated_whole(recording):
    for frame, target in zip(recording.frames[::20], recording.targets[::20], strict=True):
        assert (target.depth > 0).sum() > 0.99 * (frame.depth > 0).sum()


# A target and its range: the number of pixels is about the same, and so must be the outcome.
RANGES = [(0.05, 0.25), (0.2, 0.8), (2.0, 8.0)]  # m, radius and distance


def tumbling(k, radius, distance):
    """A ball that is never long in one place, in units of its radius."""
    x, z = 0.1 * np.sin(1.9 * k), 0.3 * np.sin(1.3 * k)
    return sphere_depth((radius * x, 0, distance + radius * z), radius, KINECT)


@pytest.mark.parametrize(('radius', 'distance'), RANGES)
def test_a_target_of_any_size_is_found_where_it_fills_the_image(radius, distance):
    scenes = [tumbling(k, radius, distance) for k in range(8)]
    for mask, depth in zip(watch(TargetIsolator(SETTINGS), scenes, KINECT), scenes, strict=True):
        np.testing.assert_array_equal(mask, depth > 0)


@pytest.mark.parametrize(('radius', 'distance'), RANGES)
def test_its_parts_belong_to_it_at_any_size(radius, distance):
    """A panel a quarter of the body's size beside it, once joined to it by what is now out of sight."""
    body = sphere_depth((0, 0, distance), radius, KINECT)
    joined = sphere_depth((1.2 * radius, 0, distance), 0.3 * radius, KINECT)
    apart = sphere_depth((1.55 * radius, 0, distance), 0.25 * radius, KINECT)
    masks = watch(TargetIsolator(SETTINGS), [together(body, joined), together(body, apart)], KINECT)
    np.testing.assert_array_equal(masks[1], (body > 0) | (apart > 0))


def noisy(depth, rng):
    """As a Kinect sees it: disparity in eighths of a pixel at a base line of 75 mm."""
    step = 0.125 / (525 * 0.075)
    seen = depth > 0
    inverse = 1 / np.where(seen, depth, 1) + rng.normal(scale=0.5 * step, size=depth.shape)
    return np.where(seen, 1 / (np.rint(inverse / step) * step), 0).astype(np.float32)


@pytest.mark.parametrize(('radius', 'distance'), [(0.2, 1.2), (0.4, 2.0)])
def test_a_target_before_a_still_wall_at_three_metres_is_found(radius, distance):
    rng = np.random.default_rng(0)
    wall = np.full((480, 640), 3.0, np.float32)
    scenes = [noisy(together(wall, tumbling(k, radius, distance)), rng) for k in range(25)]
    masks = watch(TargetIsolator(SETTINGS), scenes, KINECT)
    assert masks[0] == 'settling'
    for k, mask in enumerate(masks[15:], 15):
        np.testing.assert_array_equal(mask, tumbling(k, radius, distance) > 0)


def test_a_wall_behind_the_target_is_no_part_of_it_at_any_scale():
    """Its pixels touch those of the target in the image."""
    for scale in (0.25, 1.0, 8.0):
        wall = np.full((480, 640), 1.5 * scale, np.float32)
        scenes = [together(wall, tumbling(k, 0.2 * scale, 0.8 * scale)) for k in range(25)]
        mask = watch(TargetIsolator(SETTINGS), scenes, KINECT)[-1]
        np.testing.assert_array_equal(mask, tumbling(24, 0.2 * scale, 0.8 * scale) > 0)


def hand_at(column):
    """A bar that reaches in from the right edge up to a column, as far away as the target."""
    depth = np.zeros((120, 160), np.float32)
    depth[45:75, column:] = 0.6
    return depth


def test_a_hand_is_neither_target_nor_part_of_it():
    target = sphere_depth((0, 0, 0.6), 0.05)
    columns = np.flatnonzero(target.any(axis=0))
    far, near = 150, int(columns.max()) - 2
    isolator = TargetIsolator(SETTINGS)
    alone = watch(isolator, [target] * 20)[-1]
    comes = [together(target, hand_at(c)) for c in range(far, near + 34, -2)]
    assert len(comes) >= 3
    touches = [together(target, hand_at(near))] * 5
    masks = watch(isolator, [*comes, *touches, target], after=20)
    for mask in masks[: len(comes)]:
        np.testing.assert_array_equal(mask, alone)
    assert masks[len(comes) : -1] == ['touched'] * 5
    np.testing.assert_array_equal(masks[-1], alone)


def test_what_stays_that_large_is_the_target():
    isolator = TargetIsolator(SETTINGS)
    near = together(sphere_depth((0, 0, 0.6), 0.05), hand_at(80))
    watch(isolator, [sphere_depth((0, 0, 0.6), 0.05)] * 20)
    masks = watch(isolator, [near - np.float32(0.02 * (k % 2)) * (near > 0) for k in range(110)], after=20)
    assert masks[50] == 'touched'
    assert isinstance(masks[-1], np.ndarray)
