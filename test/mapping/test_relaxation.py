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

"""Lu-Milios relaxation of recorded views: disturbed poses come back, a false closure is bent off."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_se3, inverse, rotation_angle, transform
from debris_scanner.mapping import relaxation
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import Edge, _switch, relax, smooth
from debris_scanner.registration.projective import RegistrationStats, linearise_pairs

FRAMES = [0, 4, 8, 12, 16, 20, 24, 28]  # 11 degrees apart
CHAIN = [Edge(k + 1, k, False) for k in range(len(FRAMES) - 1)]
SKIPPING = [Edge(k + 2, k, True) for k in range(len(FRAMES) - 2)]


def scene(recording):
    return [recording.views[k] for k in FRAMES], [recording.pose(k) for k in FRAMES]


def disturbed(poses, rng, degrees, metres):
    """All but the first turned and shifted about the target's centre, which is the origin."""
    result = [poses[0]]
    for T in poses[1:]:
        turn = rng.normal(size=3)
        turn *= np.radians(degrees) / np.linalg.norm(turn)
        shift = rng.normal(size=3)
        shift *= metres / np.linalg.norm(shift)
        result.append(compose(exp_se3(np.concatenate([turn, shift])), T))
    return result


def errors(poses, truth):
    E = [compose(T, inverse(P)) for T, P in zip(poses, truth, strict=True)]
    return (
        np.degrees([rotation_angle(e[:3, :3]) for e in E]),
        np.array([np.linalg.norm(e[:3, 3]) for e in E]) * 1e3,
    )


@pytest.mark.parametrize('edges', [CHAIN, CHAIN + SKIPPING])
def test_disturbed_poses_are_pulled_back(recording, edges):
    views, truth = scene(recording)
    start = disturbed(truth, np.random.default_rng(1), 2.0, 0.004)
    relaxed = relax(views, start, edges, 12)
    turn, shift = errors(relaxed.poses, truth)
    assert errors(start, truth)[0].max() > 1.9
    # what is left is the views' own noise, added up along the chain
    assert turn.max() < 0.6
    assert shift.max() < 1.5
    assert len(relaxed.edge_stats) == len(relaxed.weights) == len(relaxed.information) == len(edges)
    assert min(a.overlap for a in relaxed.edge_stats) > 0.7  # of views 23 degrees apart
    assert relaxed.weights == [1.0] * len(edges)


def test_first_pose_is_held_and_the_input_left_alone(recording):
    views, truth = scene(recording)
    start = disturbed(truth, np.random.default_rng(2), 1.0, 0.002)
    before = [T.copy() for T in start]
    relaxed = relax(views, start, CHAIN, 6)
    np.testing.assert_array_equal(relaxed.poses[0], truth[0])
    for a, b in zip(start, before, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(relaxed.poses[1], start[1])


def test_more_edges_average_the_noise_down(recording):
    views, truth = scene(recording)
    chain = relax(views, truth, CHAIN, 12)
    woven = relax(views, truth, CHAIN + SKIPPING, 12)
    assert errors(woven.poses, truth)[0].mean() < errors(chain.poses, truth)[0].mean() + 0.02


def test_relaxed_poses_do_not_depend_on_the_order_of_the_edges(recording):
    views, truth = scene(recording)
    start = disturbed(truth, np.random.default_rng(3), 1.0, 0.002)
    forward = relax(views, start, CHAIN + SKIPPING, 12)
    backward = relax(views, start, (CHAIN + SKIPPING)[::-1], 12)
    for a, b in zip(forward.poses, backward.poses, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_false_closure_is_bent_off(recording):
    """The far side of the target, half a turn on, declared to be what the first view shows."""
    views, truth = scene(recording)
    stranger = recording.views[63]
    there = compose(truth[0], transform(np.eye(3), views[0].centroid - stranger.centroid))
    relaxed = relax([*views, stranger], [*truth, there], [*CHAIN, Edge(len(FRAMES), 0, True)], 12)
    assert relaxed.weights[:-1] == [1.0] * len(CHAIN)
    assert relaxed.weights[-1] < 0.5
    turn, shift = errors(relaxed.poses[:-1], truth)
    assert turn.max() < 0.6
    assert shift.max() < 1.5


def test_closure_keeps_its_weight_while_it_agrees_and_loses_it_fast():
    def pair(rms, free):
        return RegistrationStats(
            points=1000, matched=800, square=800 * rms**2, visible=1000, in_free_space=1000 * free
        )

    assert _switch(pair(1.0, 0.01)) == 1.0
    assert _switch(pair(1.85, 0.049)) == 1.0
    assert _switch(pair(3.8, 0.01)) == pytest.approx(1 / 16, rel=0.01)
    assert _switch(pair(1.0, 0.10)) == pytest.approx(1 / 16, rel=0.01)
    assert _switch(pair(3.8, 0.20)) < 0.005


def test_progress_is_told_once_an_iteration_and_ends_when_settled(recording):
    views, truth = scene(recording)
    outcome_text = []
    relax(views, truth, CHAIN, 50, progress=lambda: outcome_text.append(1))
    assert 1 <= len(outcome_text) < 50
    outcome_text.clear()
    start = disturbed(truth, np.random.default_rng(4), 3.0, 0.005)
    relax(views, start, CHAIN, 3, progress=lambda: outcome_text.append(1))
    assert len(outcome_text) == 3


def test_single_view_stays_where_it_is(recording):
    relaxed = relax([recording.views[0]], [recording.pose(0)], [Edge(0, 0, False)], 3)
    np.testing.assert_array_equal(relaxed.poses[0], recording.pose(0))


def test_only_what_moved_is_registered_anew(recording, monkeypatch):
    views, truth = scene(recording)
    edges = CHAIN + SKIPPING
    start = disturbed(truth, np.random.default_rng(3), 0.5, 0.002)
    registered = []

    def counted(table, poses, pairs, gate):
        registered.extend(pairs)
        return linearise_pairs(table, poses, pairs, gate)

    monkeypatch.setattr(relaxation, 'linearise_pairs', counted)
    lazy = relax(views, start, edges, 10, gates=(6.7, 6.7))
    few = len(registered)
    monkeypatch.setattr(relaxation, 'MOVED', 0.0)
    eager = relax(views, start, edges, 10, gates=(6.7, 6.7))
    assert few < 0.8 * (len(registered) - few)
    for a, b in zip(lazy.poses, eager.poses, strict=True):
        E = compose(inverse(a), b)
        assert rotation_angle(E[:3, :3]) < 5e-4
        assert np.linalg.norm(E[:3, 3]) < 3e-4


def test_a_frame_that_tells_nothing_follows_the_motion():
    """Poses registered one by one, one of them edge-on: it goes where its neighbours were going."""
    stamps = [k * 100_000_000 for k in range(30)]
    truth = [
        inverse(transform(exp_se3(np.array([0, 0.05 * k, 0, 0, 0, 0]))[:3, :3], np.array([0.0, 0, 1])))
        for k in range(30)
    ]
    rng = np.random.default_rng(2)
    found = disturbed(truth, rng, 0.2, 0.0005)
    found[12] = disturbed(truth, rng, 5.0, 0.01)[12]
    information = [np.diag(np.repeat([0.003, 5e-4], 3) ** -2.0)] * 30
    information[12] = 1e-6 * information[12]
    motion = MotionPrior(stamps, [True] * 29, found, np.zeros(3), 0.3, weight=1.0)
    before, after = errors(found, truth), errors(smooth(found, information, motion), truth)
    assert before[0][12] > 4 and after[0][12] < 0.5
    assert np.median(after[0]) < 0.8 * np.median(before[0])


def test_a_slow_bend_is_undone_though_the_motion_is_stiff(recording):
    """What holds directions that no view constrains must not hold the poses where they are."""
    members = range(0, 126, 4)
    views, truth = [recording.views[k] for k in members], [recording.pose(k) for k in members]
    n = len(views)
    stamps = [recording.frames[k].stamp_ns for k in members]
    bent = [
        compose(exp_se3(np.array([0, 0, np.radians(1.5) * np.sin(np.pi * k / n), 0, 0, 0])), T)
        for k, T in enumerate(truth)
    ]
    edges = [Edge(k, k - 1, False) for k in range(1, n)] + [Edge(n - 1, 0, True)]
    resolution = float(np.median([v.resolution for v in views]))
    motion = MotionPrior(stamps, [True] * (n - 1), truth, np.zeros(3), 0.3, resolution**2 / 0.13)
    turn, _ = errors(relax(views, bent, edges, 12, prior=motion).poses, truth)
    assert errors(bent, truth)[0].max() > 1.4
    assert turn.max() < 0.25
