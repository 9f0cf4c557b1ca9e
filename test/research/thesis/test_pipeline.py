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

"""The published method on a simulated turn of the shuttle."""

import numpy as np
import pytest

from debris_scanner.core import results
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import inverse, project_so3, rotation_angle
from debris_scanner.core.parameters import updated
from debris_scanner.research.thesis import pipeline
from debris_scanner.research.thesis.odometry import estimate
from debris_scanner.research.thesis.spring_stability import Stability

pytestmark = pytest.mark.slow


def attitude_errors(poses, truth):
    """Degrees, after one constant alignment of the target frame."""
    constant = [inverse(p.T_sensor_target) @ truth[p.stamp_ns] for p in poses]
    R = project_so3(np.mean([T[:3, :3] for T in constant], axis=0))
    return np.degrees([rotation_angle(R.T @ T[:3, :3]) for T in constant])


def errors_of_odometry_and_model(result, truth):
    """Of the frames that the model is made from, as :func:`attitude_errors`."""
    used = {p.stamp_ns for p in result.poses}
    odometry = [p for p in result.odometry_poses if p.stamp_ns in used]
    return attitude_errors(odometry, truth), attitude_errors(result.poses, truth)


@pytest.fixture(scope='module')
def closed(turning, coarse, turning_odometry):
    return pipeline.run(turning[0], coarse, motion=turning_odometry)


def test_a_model_comes_of_one_turn(closed, turning):
    assert closed.reason is None, closed.detail
    assert closed.model is not None
    assert len(closed.model.points) > 3000
    assert len(closed.model.triangles) > 3000
    assert abs(closed.model.points.mean(axis=0)).max() < 1e-5  # the origin is the centroid
    assert closed.model.rgb is None
    assert 0.1 < closed.model.radius < 0.3
    outward = (closed.model.normals * closed.model.points).sum(axis=1) > 0
    assert outward.mean() > 0.8


def test_relaxation_removes_the_drift_that_odometry_has(closed, turning):
    _, truth = turning
    before, after = errors_of_odometry_and_model(closed, truth)
    assert before.max() > 5
    assert after.max() < 0.5 * before.max()
    assert np.median(after) < 2.0


def test_elch_alone_shares_the_drift_out(turning, coarse, turning_odometry, monkeypatch):
    frames, truth = turning
    monkeypatch.setattr(pipeline, 'assess', None)  # nothing is relaxed, so no springs are judged either
    monkeypatch.setattr(pipeline.lum, 'relax', None)
    result = pipeline.run(frames, updated(coarse, {'relaxation.method': 'elch'}), motion=turning_odometry)
    assert result.reason is None, result.detail
    assert result.relaxed is None
    assert result.stability is None
    before, after = errors_of_odometry_and_model(result, truth)
    assert before.max() > 5
    assert after.max() < 0.4 * before.max()
    assert np.median(after) < 2.0


def test_elch_ahead_of_the_relaxation_begins_nearer(turning, coarse, closed, turning_odometry):
    settings = updated(coarse, {'relaxation.method': 'elch+lum', 'relaxation.outer_iterations': 3})
    result = pipeline.run(turning[0], settings, motion=turning_odometry)
    assert result.reason is None, result.detail
    assert result.relaxed.residuals[0] < 0.7 * closed.relaxed.residuals[0]
    assert attitude_errors(result.poses, turning[1]).max() < 3.0


def test_everything_that_is_plotted_is_there(closed, turning):
    frames, _ = turning
    n = len(frames)
    assert len(closed.odometry_poses) == n
    assert len(closed.odometry.ekf) == n - 1
    step = closed.odometry.ekf[20]
    assert step.omega.shape == step.three_sigma.shape == step.residual.shape == (3,)
    assert closed.probabilities.joint.shape == (n, n)
    accepted = [c for c in closed.closures if c.accepted]
    assert len(accepted) == 1  # frugal
    assert accepted[0].probability == max(c.probability for c in closed.closures)
    assert len(closed.graph_before) == n
    assert set(closed.graph_after.stamps) == {p.stamp_ns for p in closed.poses}
    assert len(closed.graph_after.edges()) == len(closed.graph_after)  # one ring
    assert closed.stability.stable
    assert closed.relaxed.residuals[-1] < closed.relaxed.residuals[0]
    assert set(closed.timing) == {'odometry', 'probabilities', 'relaxation', 'refiner'}


def test_the_same_frames_give_the_same_model_bit_for_bit(turning, coarse, closed, turning_odometry):
    some = estimate(turning[0][:12], coarse)
    np.testing.assert_array_equal(some.alignments, turning_odometry.alignments[:11])
    np.testing.assert_array_equal(some.attitudes[1:], turning_odometry.attitudes[1:12])
    again = pipeline.run(turning[0], coarse, motion=turning_odometry)
    assert again.model.points.tobytes() == closed.model.points.tobytes()
    assert again.model.triangles.tobytes() == closed.model.triangles.tobytes()


def test_greedy_ties_more_frames_together(turning, coarse, closed, turning_odometry):
    settings = updated(coarse, {'closure.search': 'greedy', 'relaxation.outer_iterations': 3})
    result = pipeline.run(turning[0], settings, motion=turning_odometry)
    assert result.reason is None, result.detail
    assert len(result.graph_after.edges()) > 2 * len(closed.graph_after.edges())
    assert sum(c.accepted for c in result.closures) > 10


def test_key_frames_by_angle_make_a_smaller_network(turning, coarse, closed):
    result = pipeline.run(turning[0], updated(coarse, {'odometry.keyframe_angle_deg': 10.0}))
    assert result.reason is None, result.detail
    assert len(result.poses) <= len(closed.poses) // 2 + 1
    assert len(result.odometry.ekf) == len(closed.odometry.ekf)  # the filter still sees every frame


def test_half_a_turn_has_no_closure(turning, coarse):
    result = pipeline.run(turning[0][:26], coarse)
    assert result.reason == results.NO_CLOSURE
    assert result.model is None
    assert result.graph_after is None
    assert len(result.graph_before) == 26
    assert 'closures' in result.detail


def test_too_few_frames_are_said_to_be(turning, coarse):
    empty = turning[0][0]
    blank = TargetFrame(5, empty.camera, empty.depth * 0, empty.depth_fit * 0, empty.normals * 0)
    for frames in ([], [empty], [blank, empty]):
        result = pipeline.run(frames, coarse)
        assert result.reason == results.TOO_FEW_FRAMES
        assert 'sequence' in result.detail


def test_an_unstable_network_is_refused_with_its_reason(turning, coarse, monkeypatch, turning_odometry):
    verdict = Stability('the network is unstable: eigenvalue +0.40', np.array([0.4]), 10.0)
    monkeypatch.setattr(pipeline, 'assess', lambda *_: verdict)
    few = updated(coarse, {'closure.min_probability': 0.9})
    result = pipeline.run(turning[0], few, motion=turning_odometry)
    assert result.reason == results.INCONSISTENT_MODEL
    assert '+0.40' in result.detail
    assert result.closures
    assert not any(c.accepted for c in result.closures)
    assert any('+0.40' in c.why for c in result.closures)


def test_odometry_alone_drifts(turning, coarse, closed, turning_odometry):
    frames, truth = turning
    alone = pipeline.odometry_only(frames, coarse, motion=turning_odometry)
    assert alone.model is not None
    assert len(alone.poses) == len(frames)
    assert alone.batch.state[5] == pytest.approx(-0.62, abs=0.04)
    assert alone.batch.residuals.shape == (len(frames) - 1, 3)
    shared = {p.stamp_ns for p in closed.poses}
    drifting = attitude_errors([p for p in alone.poses if p.stamp_ns in shared], truth)
    assert drifting.max() > 2 * attitude_errors(closed.poses, truth).max()
