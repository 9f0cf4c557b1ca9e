"""The target's pixels: the box, the largest cluster, and the cluster that continues the last one."""

import dataclasses

import numpy as np
import pytest
from synthetic import CAMERA, sphere_depth

from debris_scanner.camera import Camera
from debris_scanner.frames import FrameRejected
from debris_scanner.isolation import IsolationSettings, TargetIsolator

SETTINGS = IsolationSettings()


def together(*depths):
    """The nearest of several depth images."""
    stack = np.stack([np.where(d > 0, d, np.inf) for d in depths])
    nearest = stack.min(axis=0)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def test_mask_is_exactly_the_target():
    depth = sphere_depth()
    mask = TargetIsolator(SETTINGS).mask(depth, CAMERA)
    np.testing.assert_array_equal(mask, depth > 0)


def test_largest_cluster_is_the_target():
    large, small = sphere_depth((-0.07, 0, 0.6), 0.06), sphere_depth((0.1, 0, 0.6), 0.05)
    mask = TargetIsolator(SETTINGS).mask(together(large, small), CAMERA)
    np.testing.assert_array_equal(mask, large > 0)


def test_target_stays_the_target_when_something_larger_comes_into_view():
    isolator = TargetIsolator(SETTINGS)
    target, larger = sphere_depth((-0.1, 0, 0.6), 0.05), sphere_depth((0.1, 0, 0.6), 0.07)
    isolator.mask(target, CAMERA)
    moved = sphere_depth((-0.09, 0.01, 0.6), 0.05)
    np.testing.assert_array_equal(isolator.mask(together(moved, larger), CAMERA), moved > 0)
    # a fresh isolator has nothing to go by but size
    np.testing.assert_array_equal(TargetIsolator(SETTINGS).mask(together(moved, larger), CAMERA), larger > 0)


def test_a_jump_is_no_continuation():
    isolator = TargetIsolator(SETTINGS)
    isolator.mask(sphere_depth((-0.1, 0, 0.6), 0.05), CAMERA)
    elsewhere = sphere_depth((0.1, 0, 0.6), 0.06)
    np.testing.assert_array_equal(isolator.mask(elsewhere, CAMERA), elsewhere > 0)


def test_parts_within_the_gap_belong_together():
    near = together(sphere_depth((-0.05, 0, 0.6), 0.045), sphere_depth((0.05, 0, 0.6), 0.045))  # 10 mm apart
    assert TargetIsolator(SETTINGS).mask(near, CAMERA).sum() == (near > 0).sum()
    # a finer gap tells them apart
    fine = dataclasses.replace(SETTINGS, cluster_gap=0.004)
    assert 0 < TargetIsolator(fine).mask(near, CAMERA).sum() < 0.6 * (near > 0).sum()


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
        mask = TargetIsolator(settings).mask(depth, CAMERA)
        assert (mask & ~kept).sum() == 0
        assert mask.sum() > 0.95 * kept.sum()


@pytest.mark.parametrize(
    'depth', [np.zeros((120, 160), np.float32), sphere_depth((0, 0, 0.6), 0.015), sphere_depth((0, 0, 1.5))]
)
def test_nothing_large_enough_in_the_box_is_no_target(depth):
    with pytest.raises(FrameRejected) as rejected:
        TargetIsolator(SETTINGS).mask(depth, CAMERA)
    assert rejected.value.reason == 'no_target'


def test_many_specks_are_no_target():
    depth = np.zeros((480, 640), np.float32)
    depth[10::40, 10::40] = 0.7
    depth[11::40, 10::40] = 0.7
    depth[10::40, 11::40] = 0.7
    specks = dataclasses.replace(SETTINGS, min_pixels=100)
    with pytest.raises(FrameRejected, match='largest cluster'):
        TargetIsolator(specks).mask(depth, Camera(525, 525, 319.5, 239.5, 640, 480))


def test_recorded_target_is_isolated_whole(recording):
    for frame, target in zip(recording.frames[::20], recording.targets[::20], strict=True):
        assert (target.depth > 0).sum() > 0.99 * (frame.depth > 0).sum()
