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

"""A pattern that stays in the image shows across sides of a target, and registrations are freed from it."""

import itertools

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import apply, compose, inverse, transform
from debris_scanner.registration.projective import linearise_pair, register
from debris_scanner.sensing.fixed_pattern import disjoint_pairs, measure_pattern
from debris_scanner.sensing.views import NO_PATTERN, FixedPattern, View
from debris_scanner.settings import Settings
from debris_scanner.sim.sensors import SENSORS
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

D435 = SENSORS['d435']
BUMPS = FixedPattern(D435.bump_px / (D435.rays.focal_px * D435.baseline_m), D435.bump_length_px)


def groups(views, poses):
    """Pairs of views 1, 2, 3, 4 and 6 apart, posed T_target_view."""
    return [
        [(views[b], compose(inverse(poses[a]), poses[b]), views[a]) for a, b in disjoint_pairs(len(views), n)]
        for n in (1, 2, 3, 4, 6)
    ]


@pytest.fixture(scope='module')
def prism():
    """A turn of a prism before a D435, every 6 degrees: views and true poses."""
    preprocessor, views, poses = make_preprocessor(Settings()), [], []
    for f in Simulation(SimulationSettings(target='prism', sensor='d435', rate_hz=5.0, seconds=12.6)):
        views.append(View(preprocessor.process(DepthFrame(f.stamp_ns, f.depth, f.camera))))
        poses.append(inverse(f.T_sensor_target))
    return views, poses


def test_no_frame_is_in_two_pairs():
    for count, apart in itertools.product(range(12), (1, 2, 3, 5)):
        pairs = disjoint_pairs(count, apart)
        members = [k for pair in pairs for k in pair]
        assert len(set(members)) == len(members)
        assert all(0 <= a < b < count and b - a == apart for a, b in pairs)
    assert disjoint_pairs(8, 2) == [(0, 2), (1, 3), (4, 6), (5, 7)]


def test_the_bumps_of_a_stereo_camera_are_found(prism):
    found = measure_pattern(groups(*prism))
    # how steep they are is what registration feels; their length shows less well
    assert found.sigma / found.length_px == pytest.approx(BUMPS.sigma / BUMPS.length_px, rel=0.5)
    assert 15 <= found.length_px <= 70


def test_a_kinect_has_none(recording):
    views = [recording.views[k] for k in range(0, 126, 2)]
    poses = [recording.pose(k) for k in range(0, 126, 2)]
    assert measure_pattern(groups(views, poses)) is NO_PATTERN


def test_few_pairs_tell_nothing(prism):
    views, poses = prism
    assert measure_pattern(groups(views[:6], poses[:6])) is NO_PATTERN
    assert measure_pattern([]) is NO_PATTERN


def test_a_face_no_longer_stays_behind(prism):
    """Mean sideways error of registrations 12 degrees apart, started at the truth."""
    views, poses = prism

    def error_mm(pattern):
        found = []
        for view in views:
            view.pattern = pattern
        for a, b in zip(range(0, 60, 2), range(2, 62, 2), strict=True):
            T, _ = register(views[b], poses[b], views[a], poses[a])
            centre = inverse(poses[b])[:3, 3]
            found.append(1e3 * (apply(compose(inverse(T), poses[b]), centre) - centre)[0])
        return abs(np.mean(found))

    try:
        assert error_mm(BUMPS) < 0.5 * error_mm(NO_PATTERN)
    finally:
        for view in views:
            view.pattern = NO_PATTERN


def test_views_that_do_not_meet_have_nothing_to_take_off(prism):
    views, poses = prism
    away = compose(poses[0], transform(np.eye(3), np.array([0.0, 0.0, 5.0])))
    views[1].pattern = views[0].pattern = BUMPS
    try:
        lin = linearise_pair(views[1], away, views[0], poses[0], 5.0)
    finally:
        views[1].pattern = views[0].pattern = NO_PATTERN
    assert lin.stats.matched == 0
    assert np.isfinite(lin.H).all() and np.isfinite(lin.g).all()
