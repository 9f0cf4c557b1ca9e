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

"""The arc test finds what is out of place, names it, and says where it belongs."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, rotation_angle, transform
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.climbing import turned_along
from debris_scanner.modelling.consistency import (
    agreement,
    settled_together,
    worst_arc,
    worst_link,
    worst_shifted_arc,
)
from debris_scanner.modelling.validation import VerdictSettings
from debris_scanner.sensing.sensor_model import typical_sensor

SETTINGS = VerdictSettings()
EVERY = range(0, 126, 3)
COUNT = len(EVERY)


@pytest.fixture(scope='module')
def posed(recording):
    views = [recording.views[k] for k in EVERY]
    return PosedViews(views, [recording.pose(k) for k in EVERY], typical_sensor(views))


def moved(posed, inside, turn_deg=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    move = transform(exp_so3(np.radians(turn_deg)), np.array(shift))
    return posed.posed([compose(move, T) if k else T for k, T in zip(inside, posed.poses, strict=True)])


def test_true_poses_stand(posed):
    assert worst_arc(posed).gain < 0.1 * SETTINGS.max_gain
    assert worst_link(posed, posed.poses, range(1, COUNT)).gain == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('turn_deg', [(0.0, 2.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, -3.0)])
def test_an_arc_is_named_and_put_back(posed, turn_deg):
    inside = (np.arange(COUNT) >= 12) & (np.arange(COUNT) < 24)
    worst = worst_arc(moved(posed, inside, turn_deg))
    assert worst.gain > 2 * SETTINGS.max_gain
    # an arc somewhat longer or shorter comes to rest between here and there
    assert np.degrees(worst.turn) == pytest.approx(np.linalg.norm(turn_deg), rel=0.4)
    # it, or a part of it or of the rest: relative to each other they are the same
    first, last = worst.arc.first, worst.arc.last
    ends = [k for k in (first, last + 1) if 0 < k < COUNT]
    assert any(abs(k - end) <= 2 for k in (12, 24) for end in ends)


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_what_lies_far_off_is_tried_elsewhere(posed, axis):
    """Farther than small steps lead: key frames that agree with each other, and not with the rest."""
    shift = 0.3 * posed.beam.extent * np.eye(3)[axis]
    worst = worst_shifted_arc(moved(posed, np.arange(COUNT) < 6, shift=shift))
    assert worst.gain > 2 * SETTINGS.max_gain
    assert worst.arc.last < 6
    assert worst.shift == pytest.approx(np.linalg.norm(shift), rel=0.1)


@pytest.mark.parametrize(('first', 'last'), [(7, 16), (21, 38)])
def test_what_slid_begins_and_ends_anywhere_and_may_be_near(posed, first, last):
    inside = (np.arange(COUNT) >= first) & (np.arange(COUNT) <= last)
    shift = 0.1 * posed.beam.extent * np.eye(3)[0]
    worst = worst_shifted_arc(moved(posed, inside, shift=shift))
    assert worst.gain > 2 * SETTINGS.max_gain
    assert worst.shift == pytest.approx(np.linalg.norm(shift), rel=0.1)
    np.testing.assert_allclose(worst.move[:3, 3], -shift, atol=0.1 * np.linalg.norm(shift))
    assert abs(worst.arc.first - first) <= 1 and abs(worst.arc.last - last) <= 1


def test_true_poses_gain_nothing_elsewhere(posed):
    worst = worst_shifted_arc(posed)
    assert worst is None or worst.gain <= 0.0


@pytest.mark.parametrize('shift', [(0.0, 0.0, 0.025), (0.03, 0.0, 0.0), (0.0, 0.005, 0.0)])
def test_a_doubled_surface_is_seen(posed, shift):
    """Every third key frame is posed off: what a slipped closure leaves."""
    doubled = moved(posed, np.arange(COUNT) % 3 == 0, shift=shift)
    assert worst_arc(doubled).gain > 2 * SETTINGS.max_gain


def test_one_key_frame_is_enough(posed):
    worst = worst_arc(moved(posed, np.arange(COUNT) == 20, (0.0, 5.0, 0.0)))
    assert (worst.arc.first, worst.arc.last) == (20, 20)
    assert np.degrees(worst.turn) == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize('turn_deg', [60.0, 90.0, 180.0])
def test_what_is_too_far_off_to_find_its_way_was_torn_off(posed, turn_deg):
    flipped = moved(posed, np.arange(COUNT) >= COUNT // 2, (0.0, turn_deg, 0.0))
    torn = worst_link(flipped, posed.poses, range(1, COUNT))
    assert torn.arc.first == COUNT // 2
    assert torn.gain > 5 * SETTINGS.max_gain
    assert np.degrees(torn.turn) == pytest.approx(turn_deg, abs=0.1)


def test_a_scan_that_bends_evenly_is_straightened_by_all_pairs_together(posed):
    n = len(posed.poses)
    by = np.radians(5.0) * np.linspace(0.0, 1.0, n) ** 2
    bent = posed.posed(turned_along(posed, by, np.array([0.0, 1.0, 0.0])))
    found = bent.posed(settled_together(bent))
    assert agreement(bent) < agreement(posed) - 0.1
    assert agreement(found) > agreement(bent) + 0.1
    off = [rotation_angle(a[:3, :3] @ b[:3, :3].T) for a, b in zip(found.poses, posed.poses, strict=True)]
    assert np.degrees(max(off)) < 0.3 * 5.0


def test_two_key_frames_are_no_arc(recording):
    views = [recording.views[k] for k in (0, 3)]
    two = PosedViews(views, [recording.pose(k) for k in (0, 3)], typical_sensor(views))
    assert worst_arc(two) is None
    assert worst_shifted_arc(two) is None


def test_what_the_views_do_not_resolve_is_no_contradiction(posed):
    """Half a pixel off: a better fit is the sensor's doing, and no other place."""
    inside = np.arange(COUNT) == COUNT // 2
    near = moved(posed, inside, shift=(0.0, 0.0, 0.5 * posed.views[0].resolution))
    assert worst_arc(near).gain <= SETTINGS.max_gain
    assert worst_link(near, posed.poses, range(1, COUNT)).gain <= 0.0
    far = moved(posed, inside, shift=(0.0, 0.0, 4 * posed.views[0].resolution))
    assert worst_link(far, posed.poses, range(1, COUNT)).gain > 0.0
