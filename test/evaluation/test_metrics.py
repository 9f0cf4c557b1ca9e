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

""""""

import json
from dataclasses import replace

import numpy as np
import pytest
from coarse_frames import coarse

from debris_scanner.core.frames import DepthFrame, Model
from debris_scanner.core.geometry import apply, compose, exp_so3, inverse, transform
from debris_scanner.core.results import ClosureRecord, StampedPose
from debris_scanner.evaluation.metrics import EvaluationError, evaluate, format_table
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.sim.session import SimulationSettings, simulate, write_truth
from debris_scanner.sim.surface import sample_mesh

# The estimate's target frame: turned and shifted against the truth's.
T_TRUTH_TARGET = transform(exp_so3(np.array([0.4, 1.1, -0.6])), np.array([0.01, -0.02, 0.015]))
METRICS = [
    'attitude_deg',
    'tilt_deg',
    'attitude_untilted_deg',
    'position_mm',
    'model_mm',
    'mesh_mm',
    'completeness',
    'closures',
    'closures_by',
    'drift',
    'verdict',
    'why',
]


class Session:
    """A short recording with its truth on disk, and results made up from the truth."""

    def __init__(self, folder, target='asteroid', motion='spin', seconds=30.0):
        # one frame in half a second: 86 in 1.2 turns would be more than the figures need
        self.simulation = simulate(SimulationSettings(target, motion, seconds=seconds, rate_hz=2.0))
        self.truth_dir = folder / 'bag'
        self.stamps = [self.simulation.stamp_ns(k) for k in range(len(self.simulation))]
        self.truth = [self.simulation.pose(k) for k in range(len(self.simulation))]
        write_truth(self.truth_dir, self.stamps, self.truth, self.simulation.target)
        self.frames = [
            coarse(DepthFrame(f.stamp_ns, (f.depth_mm / 1000).astype(np.float32), f.camera))
            for f in self.simulation
        ]

    def poses(self, change=lambda k, T: T):
        """Perfect poses in the estimate's target frame, with a change to frame k's."""
        return [
            StampedPose(s, change(k, T @ T_TRUTH_TARGET))
            for k, (s, T) in enumerate(zip(self.stamps, self.truth, strict=True))
        ]

    def closure(self, a, b, turn=0.0, shift=0.0, accepted=True):
        """Closure of frames a and b whose pose turns the target about its origin, and shifts it."""
        off = transform(exp_so3(np.array([0, turn, 0])), np.array([0, 0, shift]))
        T = compose(self.truth[a], off, inverse(self.truth[b]))
        return ClosureRecord(self.stamps[a], self.stamps[b], 0.9, accepted, '', T)

    def model(self, swell=0.0, keep=lambda points: np.ones(len(points), bool)):
        """The true surface in the estimate's target frame, pushed outwards by some metres."""
        target = self.simulation.target

        def moved(points):
            radius = np.linalg.norm(points, axis=1, keepdims=True)
            return apply(inverse(T_TRUTH_TARGET), points * (1 + swell / radius)).astype(np.float32)

        points = sample_mesh(target.vertices, target.triangles, 30_000)
        points = points[keep(points)]
        normals = points / np.linalg.norm(points, axis=1, keepdims=True)
        return Model(
            moved(points), normals.astype(np.float32), moved(target.vertices.astype(float)), target.triangles
        )

    def evaluate(self, folder, result):
        write_results(folder, result, 1.0)
        return evaluate(folder, self.truth_dir, iter(self.frames))


@pytest.fixture(scope='module')
def session(tmp_path_factory):
    return Session(tmp_path_factory.mktemp('session'))


def result(session, **options):
    return ScanResult(**({'reason': None, 'model': session.model(), 'poses': session.poses()} | options))


def no_model(session, reason='no_closure', **options):
    return ScanResult(reason=reason, model=None, **options)


def test_a_perfect_result_has_no_error(session, tmp_path):
    metrics = session.evaluate(tmp_path, result(session))
    assert list(metrics) == METRICS
    assert metrics['attitude_deg']['max'] < 1e-4 and metrics['position_mm']['max'] < 1e-3
    assert metrics['model_mm']['p95'] < 1e-3 and metrics['mesh_mm']['rmse'] < 1e-3
    assert metrics['completeness'] == 1.0
    assert metrics['verdict'] == 'right'
    assert metrics['drift'] is None and metrics['closures'] == {'precision': None, 'recall': None, 'false': 0}
    json.dumps(metrics, allow_nan=False)


def test_a_scan_that_tracked_a_given_model_is_judged_by_the_same_bounds(session, tmp_path):
    metrics = session.evaluate(tmp_path / 'right', result(session, tracked=True))
    assert metrics['verdict'] == 'right' and metrics['completeness'] == 1.0
    another = result(session, tracked=True, model=session.model(swell=0.02))
    metrics = session.evaluate(tmp_path / 'wrong', another)
    assert (metrics['verdict'], metrics['why'][:10]) == ('wrong', 'model rmse')


def test_an_attitude_error_of_some_frames_shows_in_the_right_figures(session, tmp_path):
    def change(k, T):
        return (
            compose(T, transform(exp_so3(np.array([0, np.radians(2.0), 0])), np.zeros(3)))
            if k % 10 == 0
            else T
        )

    metrics = session.evaluate(tmp_path, result(session, poses=session.poses(change)))
    assert metrics['attitude_deg']['median'] < 0.02
    assert metrics['attitude_deg']['p95'] == metrics['attitude_deg']['max'] == pytest.approx(2.0, abs=0.02)
    assert metrics['position_mm']['max'] < 0.01
    assert metrics['verdict'] == 'right'


def test_two_halves_that_disagree_lie_between_them(session, tmp_path):
    half = np.array([0, np.radians(3.0), 0])
    poses = session.poses(lambda k, T: compose(T, transform(exp_so3(half), np.zeros(3))) if k % 2 else T)
    attitude = session.evaluate(tmp_path, result(session, poses=poses))['attitude_deg']
    # no constant serves both: the errors of the two halves add up to their difference
    assert attitude['median'] + attitude['max'] >= 3.0 - 0.01


def test_a_position_error_is_of_the_origin_in_millimetres(session, tmp_path):
    def change(k, T):
        return compose(transform(np.eye(3), np.array([0, 0, 0.004 if k % 10 == 0 else 0])), T)

    metrics = session.evaluate(tmp_path, result(session, poses=session.poses(change)))
    assert metrics['position_mm']['max'] == pytest.approx(4.0, abs=0.05)
    assert metrics['position_mm']['median'] < 0.05 and metrics['attitude_deg']['max'] < 1e-3


def test_a_swollen_model_is_off_by_as_much(session, tmp_path):
    metrics = session.evaluate(tmp_path, result(session, model=session.model(swell=0.001)))
    for key in ('model_mm', 'mesh_mm'):
        # outwards from the centroid is not along the normal everywhere
        assert 0.85 < metrics[key]['median'] <= 1.001 and metrics[key]['p95'] <= 1.001
        assert 0.85 < metrics[key]['rmse'] <= 1.001
    assert metrics['verdict'] == 'right'
    metrics = session.evaluate(tmp_path, result(session, model=session.model(swell=0.004)))
    assert metrics['verdict'] == 'wrong' and 'rmse' in metrics['why'] and metrics['completeness'] < 0.2


def test_the_model_gets_no_alignment_of_its_own(session, tmp_path):
    model = session.model()
    shifted = Model(model.points + np.float32(0.005), model.normals, model.vertices, model.triangles)
    metrics = session.evaluate(tmp_path, result(session, model=shifted))
    assert metrics['model_mm']['median'] > 2 and metrics['mesh_mm']['median'] < 1e-3


def test_completeness_counts_only_what_was_seen(session, tmp_path):
    whole = session.evaluate(tmp_path, result(session))['completeness']
    # the sensor looks across the spin axis, so both halves are seen alike
    half = session.evaluate(tmp_path, result(session, model=session.model(keep=lambda p: p[:, 0] > 0)))[
        'completeness'
    ]
    assert whole == 1.0 and 0.4 < half < 0.62
    front = DepthFrame(session.stamps[0], session.frames[0].depth, session.frames[0].camera)
    from_one_side = evaluate(tmp_path, session.truth_dir, [front] * 3)['completeness']
    assert abs(from_one_side - half) > 0.05


def test_a_model_in_a_slipped_attitude_is_wrong(session, tmp_path):
    slip = transform(exp_so3(np.array([0, 0, np.radians(60)])), np.zeros(3))
    poses = session.poses(lambda k, T: compose(T, slip) if k > 40 else T)
    metrics = session.evaluate(tmp_path, result(session, poses=poses))
    assert metrics['attitude_deg']['max'] == pytest.approx(60, abs=1)
    assert metrics['verdict'] == 'wrong' and 'attitude max' in metrics['why']


def test_closures_and_drift(session, tmp_path):
    turn = 2 * np.pi / 0.5
    later = min(range(len(session.stamps)), key=lambda k: abs(k / 2 - turn))
    closures = [
        session.closure(0, later),
        session.closure(0, 10, accepted=False),
        # twelve degrees apart: true, because it was registered right
        session.closure(1, later + 2),
        session.closure(3, later + 9, turn=np.radians(20.0)),
    ]
    odometry = session.poses(
        lambda k, T: compose(T, transform(exp_so3(np.array([0, 0.001 * k, 0])), np.array([0, 0, 0.0001 * k])))
    )
    metrics = session.evaluate(
        tmp_path, result(session, closures=closures, odometry=odometry, keyframe_poses=session.poses())
    )
    assert metrics['closures']['precision'] == pytest.approx(2 / 3) and metrics['closures']['false'] == 1
    assert 0 < metrics['closures']['recall'] < 0.3
    assert metrics['closures_by'] == 'pose'
    assert metrics['drift']['deg'] == pytest.approx(np.degrees(0.001 * later), rel=1e-3)
    assert metrics['drift']['mm'] == pytest.approx(0.1 * later, rel=1e-3)


def test_the_size_of_the_target_bounds_the_shift_of_a_closure(session, tmp_path):
    size = np.ptp(session.simulation.target.vertices, axis=0).max()
    for share, false in ((0.019, 0), (0.021, 1)):
        closures = [session.closure(0, 25, shift=share * size)]
        assert session.evaluate(tmp_path, result(session, closures=closures))['closures']['false'] == false


def test_a_summary_of_an_earlier_release_is_judged_by_attitude(session, tmp_path):
    """It has no poses; the thesis's ten degrees then decide, and the table says so."""
    write_results(tmp_path, result(session, closures=[session.closure(0, 25)]), 1.0)
    path = tmp_path / 'summary.json'
    content = json.loads(path.read_text())
    for c in content['closures']:
        del c['T_from_to']
    path.write_text(json.dumps(content))
    metrics = evaluate(tmp_path, session.truth_dir, iter(session.frames))
    assert metrics['closures_by'] == 'attitude'
    assert (metrics['closures']['precision'], metrics['closures']['false']) == (1.0, 0)
    assert 'false 0   (by attitude)' in format_table(metrics)


def test_a_missed_model_is_wrong_and_null_where_it_is_not(session, tmp_path):
    metrics = session.evaluate(tmp_path, no_model(session))
    assert metrics['verdict'] == 'wrong'
    assert all(metrics[k] is None for k in METRICS[:5])


def test_poses_are_judged_even_where_the_model_was_withheld(session, tmp_path):
    metrics = session.evaluate(tmp_path, no_model(session, poses=session.poses()))
    assert metrics['attitude_deg']['max'] < 1e-4 and metrics['model_mm'] is None


@pytest.mark.parametrize(
    ('target', 'motion', 'seconds', 'verdict', 'why'),
    [
        ('empty', 'spin', 5.0, 'right', 'empty'),
        ('asteroid', 'still', 15.0, 'right', 'full turn'),
        ('asteroid', 'spin', 8.0, 'right', 'full turn'),
        ('cylinder', 'spin', 15.0, 'right', 'body of revolution'),
        ('cylinder', 'tumble', 15.0, 'right', 'body of revolution'),
        ('upper_stage', 'spin', 15.0, 'wrong', 'missed'),
        ('prism', 'spin', 15.0, 'wrong', 'missed'),
    ],
)
def test_no_model_is_right_only_where_none_could_be_had(tmp_path, target, motion, seconds, verdict, why):
    session = Session(tmp_path, target, motion, seconds)
    metrics = session.evaluate(tmp_path / 'out', no_model(session))
    assert metrics['verdict'] == verdict and why in metrics['why']


def test_turns_out_of_sight_do_not_count(session, tmp_path):
    write_results(tmp_path, no_model(session), 1.0)
    dark = [
        DepthFrame(f.stamp_ns, f.depth if k < 8 else np.zeros_like(f.depth), f.camera)
        for k, f in enumerate(session.frames)
    ]
    assert evaluate(tmp_path, session.truth_dir, dark)['verdict'] == 'right'


def test_a_model_of_nothing_is_wrong(session, tmp_path):
    empty = Session(tmp_path, 'empty', 'spin', 30.0)
    metrics = empty.evaluate(tmp_path / 'out', result(session))
    assert metrics['verdict'] == 'wrong' and metrics['model_mm'] is None


def test_a_model_of_a_cylinder_is_judged_by_its_attitude(tmp_path):
    session = Session(tmp_path, 'cylinder', 'spin', 15.0)
    # what a scanner that cannot see the spin would say: the cylinder stands still
    poses = [StampedPose(s, session.truth[0] @ T_TRUTH_TARGET) for s in session.stamps]
    metrics = session.evaluate(tmp_path / 'out', result(session, poses=poses))
    assert metrics['verdict'] == 'wrong' and 'attitude' in metrics['why']


def test_a_cloud_serves_as_truth(session, tmp_path):
    points = sample_mesh(session.simulation.target.vertices, session.simulation.target.triangles, 60_000)
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'truth.tum').write_bytes((session.truth_dir / 'truth.tum').read_bytes())
    header = 'ply\nformat binary_little_endian 1.0\nelement vertex 60000\n'
    header += ''.join(f'property float {a}\n' for a in 'xyz') + 'end_header\n'
    (tmp_path / 'bag' / 'truth_cloud.ply').write_bytes(header.encode() + points.astype('<f4').tobytes())
    write_results(tmp_path / 'out', result(session), 1.0)
    metrics = evaluate(tmp_path / 'out', tmp_path / 'bag', session.frames)
    # the spacing of the truth's points is not taken off
    assert 0.01 < metrics['model_mm']['median'] < 0.8
    assert metrics['completeness'] > 0.99 and metrics['verdict'] == 'right'


@pytest.mark.parametrize(
    'missing', ['truth.tum', 'truth_mesh.ply', 'summary.json', 'target_pose.tum', 'model.ply', 'mesh.ply']
)
def test_missing_files_are_named(session, tmp_path, missing):
    out, bag = tmp_path / 'out', tmp_path / 'bag'
    write_results(out, result(session), 1.0)
    bag.mkdir()
    for name in ('truth.tum', 'truth_mesh.ply'):
        (bag / name).write_bytes((session.truth_dir / name).read_bytes())
    (bag if missing.startswith('truth') else out).joinpath(missing).unlink()
    with pytest.raises(EvaluationError, match=missing.replace('.', r'\.')):
        evaluate(out, bag, session.frames)


@pytest.mark.parametrize(
    'content', ['not json', '[]', '{"result": "maybe"}', '{"result": "no_model", "closures": [{}]}']
)
def test_a_malformed_summary_is_named(session, tmp_path, content):
    (tmp_path / 'summary.json').write_text(content)
    with pytest.raises(EvaluationError, match=r'summary\.json'):
        evaluate(tmp_path, session.truth_dir, session.frames)


def test_poses_with_other_stamps_are_refused(session, tmp_path):
    poses = [StampedPose(p.stamp_ns + 1, p.T_sensor_target) for p in session.poses()]
    with pytest.raises(EvaluationError, match=r'target_pose\.tum'):
        session.evaluate(tmp_path, result(session, poses=poses))


def test_the_table_shows_every_figure(session, tmp_path):
    table = format_table(session.evaluate(tmp_path / 'a', result(session)))
    for words in (
        'attitude error, deg',
        'median 0.000',
        'completeness',
        '1.000',
        'verdict',
        'right',
        'false 0',
    ):
        assert words in table
    closures = {'precision': 0.0, 'recall': None, 'false': 2}
    metrics = session.evaluate(tmp_path / 'a', result(session)) | {'closures': closures}
    assert 'false 2   (over 2 deg or 2% of the size off)' in format_table(metrics)
    rolled = format_table(metrics | {'closures_by': 'attitude'})
    assert 'false 2   (by attitude: over 10 deg apart, if only rolled)' in rolled
    empty = format_table(session.evaluate(tmp_path / 'b', no_model(session)))
    assert 'model error, mm         -' in empty and 'wrong' in empty


def test_the_truth_of_another_recording_is_refused(session, tmp_path):
    session.evaluate(tmp_path, result(session))
    moved = tmp_path / 'other'
    write_truth(moved, [s + 1 for s in session.stamps], session.truth, session.simulation.target)
    with pytest.raises(EvaluationError, match='is the truth of another recording'):
        evaluate(tmp_path, moved, iter(session.frames))


def test_one_pose_tells_nothing_of_the_error(session, tmp_path):
    one = result(session)
    metrics = session.evaluate(tmp_path, replace(one, poses=one.poses[:1], odometry=one.odometry[:1]))
    assert metrics['attitude_deg'] is metrics['model_mm'] is None
    assert (metrics['verdict'], metrics['why'].split(':')[0]) == ('wrong', 'one pose has a true one')
    assert '0.000' not in format_table(metrics).split('verdict')[0]
