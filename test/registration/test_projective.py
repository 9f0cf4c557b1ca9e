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

"""Projective registration on recorded views of known pose, its evidence, and rotation observability."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from synthetic import rays, sphere_depth, target_frame

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import (
    apply,
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_so3,
    rotation_angle,
    transform,
)
from debris_scanner.registration.projective import (
    MAX_STEP,
    RegistrationStats,
    linearise,
    linearise_pair,
    linearise_shapes,
    register,
    rotation_observability,
    solve_step,
)
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sensing.views import View
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.tracking.pose_search import tracking_surface

GATE = 8.0  # px


def shifted(T_target_view, offset):
    """The view moved by an offset in the sensor's frame, so that z is along the line of sight."""
    return compose(T_target_view, transform(np.eye(3), np.asarray(offset, float)))


def error(T, truth):
    E = compose(inverse(truth), T)
    return np.degrees(rotation_angle(E[:3, :3])), np.linalg.norm(E[:3, 3])


def about_centroid(view, T, twist):
    """Pose turned about what the view sees, then shifted."""
    centre = T[:3, :3] @ view.centroid + T[:3, 3]
    to, back = transform(np.eye(3), centre), transform(np.eye(3), -centre)
    return compose(to, exp_se3(np.asarray(twist, float)), back, T)


def test_view_samples_the_front_of_the_target(recording):
    view, target = recording.views[0], recording.targets[0]
    assert 500 < len(view.points) < (target.depth > 0).sum() / 8
    assert view.points.dtype == view.normals.dtype == np.float32
    rays = view.points / np.linalg.norm(view.points, axis=1, keepdims=True)
    assert (-(rays * view.normals).sum(1) > 0.199).all()
    assert not view.beside[target.depth > 0].any()
    assert np.hypot(*view.beside[0, 0]) > 10
    assert len(view.rim.points) > 50


TWISTS = [
    [0.06, 0, 0, 0, 0, 0],
    [0, 0.06, 0, 0, 0, 0.01],
    [0, 0, -0.08, 0.01, 0.01, 0],
    [0.05, 0.05, 0.05, -0.01, -0.01, -0.01],
]


@pytest.mark.parametrize('twist', TWISTS)
@pytest.mark.parametrize(('a', 'b'), [(4, 0), (60, 57)])
def test_known_transform_is_recovered(recording, a, b, twist):
    view, reference = recording.views[a], recording.views[b]
    truth = recording.pose(a)
    T, lin = register(view, about_centroid(view, truth, twist), reference, recording.pose(b))
    turn, _ = error(T, truth)
    at_centre = np.linalg.norm((compose(T, inverse(truth)) - np.eye(4)) @ [*_centre(view, truth), 1])
    assert turn < 0.5
    assert at_centre < 1e-3
    assert lin.stats.overlap > 0.85
    assert lin.stats.rms < 1.45  # px


def _centre(view, T):
    return T[:3, :3] @ view.centroid + T[:3, 3]


def test_true_poses_agree_and_displaced_ones_less_and_less(recording):
    view, reference = recording.views[3], recording.views[0]
    truth, pose = recording.pose(3), recording.pose(0)
    edge_stats = [
        linearise_pair(view, about_centroid(view, truth, [0, turn, 0, 0, 0, 0]), reference, pose, GATE).stats
        for turn in (0, 0.1, 0.3, 0.6)
    ]
    overlaps = [a.overlap for a in edge_stats]
    assert overlaps[0] > 0.9
    assert overlaps == sorted(overlaps, reverse=True)
    assert overlaps[-1] < 0.6


def test_a_surface_in_front_of_what_was_seen_contradicts_free_space(recording):
    view, reference, pose = recording.views[1], recording.views[0], recording.pose(0)
    T = recording.pose(1)
    assert linearise(view, T, reference, pose, GATE).stats.conflict_ratio < 0.02
    # the view pulled towards the reference's sensor stands where that saw nothing
    near = linearise(view, shifted(T, [0, 0, -0.05]), reference, pose, GATE).stats
    assert near.conflict_ratio > 0.5
    assert near.overlap < 0.2
    # pushed away it is hidden, which is no contradiction
    far = linearise(view, shifted(T, [0, 0, 0.05]), reference, pose, GATE).stats
    assert far.conflict_ratio < 0.1
    assert far.occluded > 0.5 * far.points


def test_points_beside_the_silhouette_are_counted(recording):
    view, reference, pose = recording.views[1], recording.views[0], recording.pose(0)
    T = recording.pose(1)
    assert linearise(view, T, reference, pose, GATE).stats.silhouette_violation_ratio < 0.02
    beside = linearise(view, shifted(T, [0.06, 0, 0]), reference, pose, GATE).stats
    assert beside.silhouette_violation_ratio > 0.3
    gone = linearise(view, shifted(T, [0.6, 0, 0]), reference, pose, GATE).stats
    assert gone.silhouette_violation_ratio == 1
    assert gone.matched == 0


def test_silhouette_alone_brings_a_sphere_back_sideways():
    """Shifted across the line of sight a sphere's rim tells what its surface hardly does."""
    view = View(target_frame(sphere_depth((0, 0, 0.6), 0.08)))
    only_rim = View(target_frame(sphere_depth((0, 0, 0.6), 0.08)))
    only_rim.points = only_rim.points[:0]
    only_rim.normals = only_rim.normals[:0]
    only_rim.anchors = only_rim.anchors[:0]
    off = transform(np.eye(3), np.array([0.006, -0.004, 0.0]))
    lin = linearise(only_rim, off, view, np.eye(4), GATE)
    downhill = -lin.g[3:]
    assert downhill[:2] @ off[:2, 3] < 0
    assert lin.stats.points == 0


def test_normal_equations_are_symmetric_positive_and_change_sides(recording):
    a, b = recording.views[4], recording.views[0]
    T_a, T_b = about_centroid(a, recording.pose(4), [0.01, 0.02, 0, 0, 0.002, 0]), recording.pose(0)
    ab, ba = linearise_pair(a, T_a, b, T_b, GATE), linearise_pair(b, T_b, a, T_a, GATE)
    np.testing.assert_allclose(ab.H, ab.H.T, atol=1e-9)
    assert np.linalg.eigvalsh(ab.H).min() > 0
    np.testing.assert_allclose(ab.H, ba.H, rtol=1e-9)
    np.testing.assert_allclose(ab.g, -ba.g, rtol=1e-9, atol=1e-12)
    assert ab.stats.matched == ba.stats.matched


def test_every_second_point_stands_for_two(recording):
    view, reference = recording.views[4], recording.views[0]
    T = about_centroid(view, recording.pose(4), [0.03, 0, -0.02, 0.003, 0, 0.002])
    every = linearise_shapes(view, T, reference, recording.pose(0), GATE)
    second = linearise_shapes(view, T, reference, recording.pose(0), GATE, step=2)
    np.testing.assert_allclose(second.H, every.H, atol=0.05 * np.abs(every.H).max())
    step, few = solve_step(every.H, every.g), solve_step(second.H, second.g)
    np.testing.assert_allclose(few, step, atol=0.15 * np.abs(step).max())
    assert second.stats.points == pytest.approx(every.stats.points / 2, abs=1)


def test_step_goes_downhill(recording):
    view, reference = recording.views[4], recording.views[0]
    T = about_centroid(view, recording.pose(4), [0.03, 0, -0.02, 0.003, 0, 0.002])
    lin = linearise_pair(view, T, reference, recording.pose(0), GATE)
    after = linearise_pair(
        view, compose(exp_se3(solve_step(lin.H, lin.g)), T), reference, recording.pose(0), GATE
    )
    assert after.stats.rms < lin.stats.rms
    assert after.stats.overlap >= lin.stats.overlap


def test_poses_in_another_target_frame_give_the_same_agreement(recording):
    view, reference = recording.views[4], recording.views[0]
    moved = exp_se3(np.array([0.5, -1.0, 2.0, 0.3, -0.2, 0.1]))
    here = linearise_pair(view, recording.pose(4), reference, recording.pose(0), GATE)
    there = linearise_pair(
        view, compose(moved, recording.pose(4)), reference, compose(moved, recording.pose(0)), GATE
    )
    assert there.stats.matched == pytest.approx(here.stats.matched, rel=2e-3)
    assert there.stats.rms == pytest.approx(here.stats.rms, rel=1e-3)
    # the twist's point of reference changes with the frame, its translational stiffness only turns
    R = moved[:3, :3]
    np.testing.assert_allclose(there.H[3:, 3:], R @ here.H[3:, 3:] @ R.T, rtol=1e-2, atol=2)


def test_views_that_share_nothing_are_not_registered(recording):
    view = recording.views[0]
    assert register(view, shifted(recording.pose(0), [0.6, 0, 0]), view, recording.pose(0)) is None


def test_steps_are_bounded_and_weak_directions_stay():
    H = np.diag([1.0, 1.0, 1.0, 100.0, 100.0, 0.0])
    step = solve_step(H, np.array([-3.0, 0, 0, -1.0, 0, 0]))
    assert np.linalg.norm(step[:3]) == pytest.approx(MAX_STEP)
    assert step[5] == 0
    small = solve_step(np.eye(6), np.full(6, -0.01))
    np.testing.assert_allclose(small, 0.01, rtol=1e-5)


def test_agreements_add_up():
    a = RegistrationStats(
        points=100, matched=60, square=60 * 0.64, visible=80, in_free_space=4, occluded=20, outside_mask=10
    )
    assert a.overlap == pytest.approx(0.75)
    assert a.rms == pytest.approx(0.8)
    assert a.conflict_ratio == pytest.approx(0.05)
    assert a.silhouette_violation_ratio == pytest.approx(0.1)
    assert a.visible_inlier_ratio == pytest.approx(60 / 90)
    both = a + a
    assert (both.points, both.matched) == (200, 120)
    assert both.overlap == a.overlap
    assert (
        RegistrationStats().overlap
        == RegistrationStats().rms
        == RegistrationStats().conflict_ratio
        == RegistrationStats().silhouette_violation_ratio
        == 0
    )


def test_what_the_target_hides_is_no_evidence_against_a_model(true_model, recording):
    """The orbiter hides a third of the tank's points that face the sensor."""
    surface = tracking_surface(true_model)
    for k in (0, 50, 90):
        a = linearise(surface, np.eye(4), recording.views[k], recording.pose(k), GATE).stats
        assert a.visible_inlier_ratio > 0.9
        assert a.hidden <= min(a.visible, a.occluded)
    # a third of a turn off, what matches by chance explains little
    wrong = linearise(surface, np.eye(4), recording.views[0], recording.pose(42), GATE).stats
    assert wrong.visible_inlier_ratio < 0.5


BOUND = 0.0017  # a cylinder's stays near 0.0005


def observe(target, **options):
    """Observability of a frame against the one before, 6 degrees of turn apart."""
    simulation = simulate(SimulationSettings(target, seconds=0.5, rate_hz=5, **options))
    preprocessor = Preprocessor(IsolationSettings(), NormalSettings())
    views, poses = [], []
    for frame in simulation:
        depth = (frame.depth_mm / 1000).astype(np.float32)
        views.append(View(preprocessor.process(DepthFrame(frame.stamp_ns, depth, frame.camera))))
        poses.append(inverse(frame.T_sensor_target))
    lin = linearise_pair(views[1], poses[1], views[0], poses[0], GATE)
    return rotation_observability(lin.H, lin.stats.matched, views[1], poses[1])


@pytest.mark.parametrize('seed', [0, 1])
def test_cylinder_does_not_show_its_rotation(seed):
    assert observe('cylinder', seed=seed) < BOUND


@pytest.mark.parametrize('target', ['shuttle_stack', 'prism', 'cubesat', 'asteroid', 'tank_boosters'])
def test_other_targets_do(target):
    assert observe(target) > 1.5 * BOUND


def test_value_does_not_depend_on_frame_or_scale(recording):
    view, pose = recording.views[2], recording.pose(2)
    lin = linearise_pair(view, pose, recording.views[0], recording.pose(0), GATE)
    here = rotation_observability(lin.H, lin.stats.matched, view, pose)
    # the same normal matrix for a twist about another origin, in a turned frame
    moved = exp_se3(np.array([0.3, -0.4, 1.0, 0.5, -0.2, 0.4]))
    R, t = moved[:3, :3], moved[:3, 3]
    adjoint = np.zeros((6, 6))  # twist in the old frame per twist in the new one
    adjoint[:3, :3] = adjoint[3:, 3:] = R.T
    adjoint[3:, :3] = -R.T @ np.cross(np.eye(3), t).T
    H = adjoint.T @ lin.H @ adjoint
    there = rotation_observability(H, lin.stats.matched, view, compose(moved, pose))
    assert there == pytest.approx(here, rel=1e-3)
    assert np.isfinite(apply(pose, view.centroid)).all()
    # twice the points carry twice the information: per point it is the same
    assert rotation_observability(2 * lin.H, 2 * lin.stats.matched, view, pose) == pytest.approx(here)


def _ellipsoid(T_sensor_target):
    """Depth of one of 26 x 16 x 20 cm."""
    R, t = T_sensor_target[:3, :3], T_sensor_target[:3, 3]
    semi_axes = np.array([0.13, 0.08, 0.10])
    d, c = (rays() @ R) / semi_axes, (R.T @ t) / semi_axes
    a, b = (d * d).sum(-1), d @ c
    root = b * b - a * (c @ c - 1)
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)


def test_correlated_noise_shortens_motions_less():
    """Several per cent are lost where a residual turns about an anchor that shares its noise."""
    rng, errors = np.random.default_rng(1), []
    step = exp_so3(np.radians(10) * np.array([0.0, 1.0, 0.0]))
    for k in range(150):
        R = exp_so3(np.array([0.3, 0.1 * k, 0.2]))
        poses = [transform(rotation, np.array([0.0, 0.0, 0.6])) for rotation in (R, step @ R)]
        views = []
        for T in poses:
            depth, noise = _ellipsoid(T), gaussian_filter(rng.normal(size=(120, 160)), 2.0)
            noisy = depth + (0.003 * noise / noise.std()).astype(np.float32)
            views.append(View(target_frame(np.where(depth > 0, noisy, 0).astype(np.float32))))
        both = []
        for shared in (views[0].shared_noise, 0.0):
            for view in views:
                view.shared_noise = shared
            found, _ = register(views[1], inverse(poses[1]), views[0], inverse(poses[0]))
            both.append(np.degrees(log_so3(compose(poses[1], found)[:3, :3])[1]))
        errors.append(both)
    mean, as_before = np.mean(errors, axis=0)
    assert as_before > 0.25, 'degrees short, of a motion by 10'
    assert mean < as_before - 0.5


def test_a_thinned_view_says_as_much_in_a_quarter_of_the_time(recording):
    a, b, T_a, T_b = recording.views[0], recording.views[4], recording.pose(0), recording.pose(4)
    thin = a.thinned(4)
    assert len(thin.points) == -(-len(a.points) // 4)
    all_points, some = (linearise(view, T_a, b, T_b, GATE) for view in (a, thin))
    assert some.stats.matched == pytest.approx(all_points.stats.matched / 4, rel=0.1)
    np.testing.assert_allclose(np.diag(some.H), np.diag(all_points.H), rtol=0.15)
