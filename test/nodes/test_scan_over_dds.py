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

"""The four nodes and the simulated camera: services, late joiners, and the end on a signal."""

import json
import os
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from debris_scanner.core.geometry import compose, inverse
from debris_scanner.io.trajectories import read_tum
from debris_scanner.nodes.lifecycle import qos
from msg_adapters.clouds import read_fields
from msg_adapters.models import fingerprint, read_model
from msg_adapters.poses import read_odometry, read_path, read_target_pose
from msg_adapters.stamps import read_stamp

pytestmark = pytest.mark.ros

STAGES = ('preprocess', 'odometry', 'closure', 'graph')
FILES = {'model.pcd', 'model.ply', 'mesh.ply', 'mesh.vtk', 'target_pose.tum', 'odometry.tum'}
FILES |= {'rates.csv', 'graph.g2o', 'summary.json', 'closure_probabilities.npz'}


def start(nodes, out, seconds=60.0, spin=1.0):
    reliable = ['-p', 'input_reliability:=reliable']
    for stage in STAGES:
        given = (
            reliable if stage == 'preprocess' else ['-p', f'output_dir:={out}'] if stage == 'graph' else []
        )
        nodes.start(stage, ['--ros-args', *given])
    camera = {'seconds': seconds, 'spin_rad_s': spin, 'wait_for_stages': f'"{" ".join(STAGES)}"'}
    camera['range_m'] = 1.6  # few pixels: a model takes seconds
    given = [part for name, value in camera.items() for part in ('-p', f'{name}:={value}')]
    nodes.start('sim_kinect', ['--ros-args', *given])


def end(nodes, node, number, patience_s=60):
    """The exit code of a node after a signal."""
    process = nodes._children[node].process
    os.kill(process.pid, number)
    process.join(patience_s)
    return process.exitcode


def _model_of(status):
    return next(v.value for v in status.status[0].values if v.key == 'model_id')


@pytest.mark.slow
def test_services_late_joiners_and_sigterm(nodes, peer, tmp_path):
    out = tmp_path / 'out'
    states = peer.listen(String, 'state', qos.latched())
    odometry, target_poses = (
        peer.listen(Odometry, 'odometry'),
        peer.listen(PoseWithCovarianceStamped, 'target_pose'),
    )
    statuses = peer.listen(DiagnosticArray, 'odometry_status')
    start(nodes, out)
    peer.until(lambda: len(odometry) > 5, 'odometry')

    # too early: an answer with the reason, and the scan continues
    early = peer.call(Trigger, 'graph/generate_model')
    assert not early.success
    assert early.message.startswith('no model: ')

    peer.until(lambda: any(s.data == 'tracking' for s in states), 'tracking')
    assert [s.data for s in states if s.data != 'lost'][-3:] == ['scanning', 'generating', 'tracking']
    peer.until((out / 'summary.json').is_file, 'the files, saved as soon as the model was made')

    # whoever comes now gets the model all the same, whole
    models, meshes, poses = (
        peer.listen(kind, topic, qos.latched())
        for kind, topic in ((PointCloud2, 'model'), (Marker, 'model_mesh'), (Path, 'keyframe_poses'))
    )
    peer.until(lambda: models and meshes and poses, 'the latched model')
    assert models[-1].header.frame_id == 'target'
    assert read_stamp(poses[-1].header.stamp) == fingerprint(models[-1])
    model = read_model(models[-1], meshes[-1])
    assert len(model.points) > 5000
    assert len(model.triangles) > 5000
    assert 0.1 < model.radius < 0.3

    # poses say which target frame they are in
    peer.until(lambda: odometry[-1].child_frame_id == 'target', 'tracked odometry')
    assert odometry[0].child_frame_id == 'target_scanning'
    # target_pose is that of one frame from the start: it differs from the other by nothing, or by a constant
    named = {read_stamp(p.header.stamp): read_target_pose(p).T_sensor_target for p in target_poses}
    moved = {'target': [], 'target_scanning': []}
    for message in odometry:
        if (T := named.get(read_stamp(message.header.stamp))) is not None:
            moved[message.child_frame_id].append(compose(inverse(read_odometry(message).T_sensor_target), T))
    assert np.allclose(moved['target_scanning'], np.eye(4), atol=1e-9)
    assert np.allclose(moved['target'][-1], moved['target'][-2], atol=1e-9)

    # where it will be in the next minute
    forecasts, states = peer.listen(Path, 'forecast'), peer.listen(PointCloud2, 'forecast_states')
    peer.until(lambda: forecasts and states, 'the forecast')
    assert len(forecasts[0].poses) == states[0].width == 60
    ahead = [stamp - read_stamp(forecasts[0].header.stamp) for stamp, _ in read_path(forecasts[0])]
    assert (ahead[0], ahead[-1]) == (1_000_000_000, 60_000_000_000)
    named = read_fields(states[0], ['seconds', 'x', 'qw', 'omega_z', 'sigma_position_x', 'sigma_attitude_z'])
    assert named['seconds'].tolist() == list(range(1, 61))
    sigma = named['sigma_attitude_z']  # it grows, and about one axis wavers as the target turns
    assert sigma[-1] > 2 * sigma[0] > 0 and (np.diff(sigma) > -0.05 * sigma[:-1]).all()

    # and which model they belong to
    ids = peer.listen(String, 'model_id', qos.latched())
    peer.until(lambda: ids, 'the name of the model')
    assert ids[-1].data == f'{fingerprint(models[-1]):08x}' == meshes[-1].text
    assert _model_of(statuses[0]) == ''
    peer.until(lambda: _model_of(statuses[-1]) == ids[-1].data, 'a frame that is tracked by it')
    peer.until(lambda: float(peer.reports['odometry'].values['turned_deg']) > 300, 'the turn seen')

    # pausing stops the frames at the door
    assert peer.call(SetBool, 'graph/pause', SetBool.Request(data=True)).success
    peer.until(lambda: peer.rejected('preprocess').get('paused', 0) > 2, 'paused frames')
    assert peer.call(SetBool, 'graph/pause', SetBool.Request(data=False)).success

    saved = peer.call(Trigger, 'graph/save_model')
    assert saved.success
    assert str(out / 'model.ply') in saved.message
    again = peer.call(Trigger, 'graph/generate_model')
    assert again.success, again.message

    (out / 'summary.json').unlink()
    assert end(nodes, 'graph', signal.SIGTERM) == 0
    assert {f.name for f in out.iterdir()} >= FILES
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['result'] == 'model'
    assert summary['frames']['rejected']['paused'] > 2
    assert 'lost_in_transport' not in summary['frames']['rejected']
    assert summary['frames']['used'] == len(read_tum(out / 'target_pose.tum'))
    for stage in STAGES[:-1]:
        assert end(nodes, stage, signal.SIGTERM) == 0, stage


def test_reset_and_sigint_before_the_loop_has_closed(nodes, peer, tmp_path):
    out = tmp_path / 'out'
    odometry = peer.listen(Odometry, 'odometry')
    start(nodes, out, spin=0.3)
    peer.until(lambda: len(odometry) > 20, 'odometry')
    before_ns = read_stamp(odometry[-1].header.stamp)
    assert peer.call(Trigger, 'graph/reset').success
    count = len(odometry)
    peer.until(lambda: len(odometry) > count + 20, 'odometry after the reset')
    time.sleep(1.2)  # the other nodes' next reports
    assert end(nodes, 'graph', signal.SIGINT) == 0
    summary = json.loads((out / 'summary.json').read_text())
    assert (summary['result'], summary['reason']) == ('no_model', 'interrupted')
    poses = read_tum(out / 'target_pose.tum')
    assert len(poses) > 15
    assert poses[0].stamp_ns > before_ns, 'the old scan is still in the new one'
    assert summary['frames']['used'] == len(poses)
    assert not (out / 'model.ply').exists()
    assert summary['timing']['latency_odometry']['count'] >= len(poses)


@pytest.mark.slow
def test_the_end_of_a_recording_saves_and_ends_the_process(nodes, peer, tmp_path, brief_bag):
    out = tmp_path / 'out'
    given = (
        'input_reliability:=reliable',
        f'output_dir:={out}',
        'finish_after_idle:=3.0',
        'exit_after_idle:=true',
    )
    nodes.start('scanner', ['--ros-args', *(p for g in given for p in ('-p', g))])
    played = (f'bag:={brief_bag}', 'wait_for_stages:=scanner')
    nodes.start('play_bag', ['--ros-args', *(p for g in played for p in ('-p', g))])
    assert nodes.wait('scanner', 150)
    assert nodes.exit_code('scanner') == 0
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['result'] == 'model'
    assert summary['frames']['read'] == 45
