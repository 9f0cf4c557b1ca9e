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

"""Whether the rotation shows: a body of revolution from anything else."""

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import apply, compose, exp_se3, inverse
from debris_scanner.modelling.validation import VerdictSettings
from debris_scanner.registration.projective import linearise_pair, rotation_observability
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sensing.views import View
from debris_scanner.sim.session import SimulationSettings, simulate

BOUND = VerdictSettings().min_observability


def observe(target, **options):
    """Observability of a frame against the one before, 6 degrees of turn apart."""
    simulation = simulate(SimulationSettings(target, seconds=0.5, rate_hz=5, **options))
    preprocessor = Preprocessor(IsolationSettings(), NormalSettings())
    views, poses = [], []
    for frame in simulation:
        depth = (frame.depth_mm / 1000).astype(np.float32)
        views.append(View(preprocessor.process(DepthFrame(frame.stamp_ns, depth, frame.camera))))
        poses.append(inverse(frame.T_sensor_target))
    lin = linearise_pair(views[1], poses[1], views[0], poses[0], 0.012)
    return rotation_observability(lin.H, lin.agreement.matched, views[1], poses[1])


@pytest.mark.parametrize('seed', [0, 1])
def test_cylinder_does_not_show_its_rotation(seed):
    assert observe('cylinder', seed=seed) < BOUND


@pytest.mark.parametrize('target', ['shuttle_stack', 'prism', 'cubesat', 'asteroid', 'tank_boosters'])
def test_other_targets_do(target):
    assert observe(target) > 1.5 * BOUND


def test_value_does_not_depend_on_frame_or_scale(recording):
    view, pose = recording.views[2], recording.pose(2)
    lin = linearise_pair(view, pose, recording.views[0], recording.pose(0), 0.012)
    here = rotation_observability(lin.H, lin.agreement.matched, view, pose)
    # the same normal matrix for a twist about another origin, in a turned frame
    moved = exp_se3(np.array([0.3, -0.4, 1.0, 0.5, -0.2, 0.4]))
    R, t = moved[:3, :3], moved[:3, 3]
    adjoint = np.zeros((6, 6))  # twist in the old frame per twist in the new one
    adjoint[:3, :3] = adjoint[3:, 3:] = R.T
    adjoint[3:, :3] = -R.T @ np.cross(np.eye(3), t).T
    H = adjoint.T @ lin.H @ adjoint
    there = rotation_observability(H, lin.agreement.matched, view, compose(moved, pose))
    assert there == pytest.approx(here, rel=1e-3)
    assert np.isfinite(apply(pose, view.centroid)).all()
    # twice the points carry twice the information: per point it is the same
    assert rotation_observability(2 * lin.H, 2 * lin.agreement.matched, view, pose) == pytest.approx(here)
