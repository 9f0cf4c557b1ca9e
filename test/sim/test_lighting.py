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

"""Simulated pictures: paint under a lamp, and the echo of the sensor's own light."""

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.sim.lighting import GLOSSY, LAMP, MARKINGS, PLAIN, Lighting
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.sim.targets import BACKGROUND


def frame(index=2, **given):
    settings = SimulationSettings(target='cylinder', seconds=1.0, rate_hz=5.0, **given)
    return simulate(settings).frame(index)


def test_the_same_settings_give_the_same_pictures():
    for given in ({'colour': True, 'light': LAMP}, {'infrared': True, 'paint': MARKINGS}):
        assert np.array_equal(frame(**given).picture, frame(**given).picture)
        assert not np.array_equal(frame(**given).picture, frame(**given, seed=1).picture)


def test_a_lamp_shades_what_turns_away_from_it_and_gloss_adds_light():
    seen = [frame(colour=True, paint=PLAIN, light=light, noise=False) for light in (None, LAMP, GLOSSY)]
    even, shaded, glossy = (f.rgb[f.depth > 0].astype(int) for f in seen)
    assert np.ptp(even) == 0
    columns = np.nonzero(seen[0].depth)[1]
    left = columns < np.median(columns)
    assert shaded[left].mean() > 1.5 * shaded[~left].mean()  # the lamp is to the upper left
    assert (glossy >= shaded).all() and (glossy - shaded).max() > 30
    assert (seen[1].rgb[seen[1].depth == 0] == BACKGROUND).all()


def test_markings_are_a_twentieth_of_the_surface():
    shares = [(f.rgb[f.depth > 0] < 60).mean() for f in simulate(SimulationSettings(
        target='cylinder', colour=True, paint=MARKINGS, noise=False, seconds=12.6, rate_hz=1.0))]  # fmt: skip
    assert 0.02 < np.mean(shares) < 0.1


def test_the_echo_is_brightest_where_the_target_is_near_and_faces_the_sensor():
    simulation = simulate(SimulationSettings(target='cylinder', infrared=True, paint=PLAIN, noise=False))
    made, T = simulation.frame(0), simulation.pose(0)
    lighting = Lighting(simulation.target, find_sensor('kinect1').rays, PLAIN, None, None)
    farther = T.copy()
    farther[:3, 3] *= 1.25
    rows, columns = np.nonzero(made.depth)
    z, values = made.depth[rows, columns], made.infrared[rows, columns].astype(float)
    near = z < np.quantile(z, 0.1)
    assert values[near].mean() > 1.2 * values[~near].mean()
    # a sensor's gain follows the target
    assert lighting.echo(made.depth, farther, 0.0).max() == pytest.approx(values.max(), rel=0.1)


def test_a_lidar_sends_the_intensity_of_its_points():
    seen = frame(sensor='lidar', infrared=True, paint=MARKINGS)
    assert seen.infrared.shape == (len(seen.points),)
    scanned = DepthFrame.from_cloud(1, seen.points, seen.infrared)
    assert len(np.unique(scanned.rgb[scanned.depth > 0])) > 10


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ({'colour': True, 'paint': 'markngs'}, "did you mean 'markings'"),
        ({'colour': True, 'light': 'sun'}, "unknown light 'sun'"),
        ({'colour': True, 'infrared': True}, 'not both'),
        ({'light': LAMP}, 'a lamp lights a picture in colour'),
    ],
)
def test_what_cannot_be_shown_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        simulate(SimulationSettings(**given))


def test_nothing_is_seen_of_an_empty_scene():
    empty = simulate(SimulationSettings(target='empty', infrared=True, seconds=1.0)).frame(0)
    assert not empty.infrared.any()
