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

"""The sensor's offset is found together with the poses, and none where there is none."""

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import inverse, rotation_angle
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import Edge, compliance, relax
from debris_scanner.mapping.self_calibration import MOST_STEPS, depth_offset
from debris_scanner.sensing.depth_offset import NO_OFFSET, SUPPORT, DepthOffset
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.modelled_sensor import ModelledSensor
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

SCALE = Settings().motion.information_scale


class Scan:
    """A turn and a half of a target every 9 degrees: views, true poses, and pairs that look alike."""

    def __init__(self, target, sensor):
        preprocessor, self.views, self.truth, self.stamps = make_preprocessor(Settings()), [], [], []
        simulation = Simulation(
            SimulationSettings(target=target, sensor=sensor, rate_hz=10 / 3, seconds=18.0)
        )
        self.sensor, self.target = sensor, simulation.target
        for f in simulation:
            self.views.append(View(preprocessor.process(DepthFrame(f.stamp_ns, f.depth, f.camera))))
            self.truth.append(inverse(f.T_sensor_target))
            self.stamps.append(f.stamp_ns)
        n = len(self.views)
        turn = [[rotation_angle(a[:3, :3] @ b[:3, :3].T) for a in self.truth] for b in self.truth]
        self.edges = [
            Edge(i, j, i > j + 1) for i in range(n) for j in range(i) if i == j + 1 or turn[i][j] < 0.4
        ]

    def at_pixels(self, offset):
        """The share that was found, and that the sensor has, where the target was seen (k,)."""
        wide = find_sensor(self.sensor).rays.camera
        sensor = ModelledSensor(find_sensor(self.sensor), self.target)
        x, y = np.concatenate([v.points[:, :2] / v.points[:, 2:] for v in self.views])[::50].T
        at = np.rint(y * wide.fy + wide.cy).astype(int), np.rint(x * wide.fx + wide.cx).astype(int)
        model = sensor.model
        disparity = model.range_m / (wide.fx * model.baseline_m) if model.bump_px else 0.0
        return offset.share(wide)[at], sensor.offset[at] + disparity * model.bump_px * sensor.bumps[at]

    def relaxed(self, views):
        return relax(views, self.truth, self.edges, 8, (6.7, 4.0), self.prior())

    def prior(self):
        n = len(self.views)
        weight = self.views[0].resolution ** 2 / SCALE
        return MotionPrior(self.stamps, [True] * (n - 1), self.truth, np.zeros(3), 0.3, weight)

    def offset(self, relaxed, views, known=NO_OFFSET):
        return depth_offset(views, self.edges, relaxed, self.prior(), 4.0, SCALE, known)

    def error_deg(self, poses):
        """Median, but for what all have in common: a tilt of the sensor turns all alike."""
        R = np.array([a[:3, :3] @ b[:3, :3].T for a, b in zip(poses, self.truth, strict=True)])
        return float(np.degrees(np.median([rotation_angle(R[0].T @ r) for r in R])))


@pytest.fixture(scope='module')
def flexx():
    return Scan('asteroid', 'flexx')


def freed(views, offset):
    normals = Settings().normals
    return [View(offset.freed(v.frame, normals)) for v in views]


def test_the_offset_of_a_time_of_flight_camera_is_found_and_the_poses_with_it(flexx):
    relaxed = flexx.relaxed(flexx.views)
    offset = flexx.offset(relaxed, flexx.views)
    found, put_in = flexx.at_pixels(offset)
    assert np.corrcoef(found, put_in)[0, 1] > 0.9
    assert np.std(found - put_in) < 0.5 * np.std(put_in)
    views = freed(flexx.views, offset)
    again = flexx.relaxed(views)
    assert flexx.error_deg(again.poses) < 0.6 * flexx.error_deg(relaxed.poses)
    # what is known is taken into account: little is left to be found
    better = flexx.offset(again, views, offset)
    camera = flexx.views[0].frame.camera
    change = better.share(camera) - offset.share(camera)
    assert np.std(change) < 0.5 * np.std(offset.share(camera))


def test_a_kinect_without_one_has_none():
    kinect = Scan('asteroid', 'kinect1')
    assert kinect.offset(kinect.relaxed(kinect.views), kinect.views) is NO_OFFSET


def test_nothing_is_found_where_nothing_is_seen(flexx):
    relaxed = flexx.relaxed(flexx.views)
    apart = [np.array(T) for T in relaxed.poses]
    for k, T in enumerate(apart):
        T[2, 3] += k
    relaxed.poses = apart
    assert flexx.offset(relaxed, flexx.views) is NO_OFFSET


def test_no_lattice_grows_without_end(flexx):
    """What is known on a lattice too fine for all that is seen goes on to a coarser one."""
    known = DepthOffset(1e-3, (0, 0), np.full((6, 6), 1e-3))
    assert np.ptp(flexx.views[0].points[:, 0] / flexx.views[0].points[:, 2]) > MOST_STEPS * known.step
    found = flexx.offset(flexx.relaxed(flexx.views), flexx.views, known)
    assert found.step > known.step and max(found.coefficients.shape) <= MOST_STEPS + SUPPORT
    put_in = flexx.at_pixels(found)
    assert np.corrcoef(*put_in)[0, 1] > 0.9


def test_the_bumps_of_a_stereo_camera_are_found():
    scan = Scan('cubesat', 'd435')
    found, bumps = scan.at_pixels(scan.offset(scan.relaxed(scan.views), scan.views))
    # with four steps to the target's extent: 0.70
    assert np.corrcoef(found, bumps)[0, 1] > 0.9


def test_poses_give_way_to_a_pull_and_to_each_others_alike(flexx):
    """The first is held; what a pull on one moves another, the same on the other moves the one."""
    relaxed = flexx.relaxed(flexx.views)
    pulls = np.zeros((len(flexx.views), 6, 2))
    pulls[20, 4, 0] = pulls[25, 1, 1] = 1.0
    given = compliance(flexx.edges, relaxed, flexx.prior(), pulls)
    assert not given[0].any()
    assert given[20, 4, 0] > 0 < given[25, 1, 1]
    assert given[25, 1, 0] == pytest.approx(given[20, 4, 1], rel=1e-6)
    np.testing.assert_allclose(compliance(flexx.edges, relaxed, flexx.prior(), 3 * pulls), 3 * given)
