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

"""A target that comes into sight grows; one that is in sight does not count as coming.

What hides a part is told by a whole view; without one, what was half hidden lately still is.
"""

import dataclasses

import numpy as np
import pytest
from frame_fits import fit

from debris_scanner.core.geometry import inverse, transform
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.occlusion import (
    LONGEST_EMERGING_NS,
    LONGEST_OCCLUSION_NS,
    PARTIAL_VIEWS,
    Appearance,
    Occlusion,
)

MAX_GAP = 0.35


def outcome_text(counts, hz=10.0, start_s=0.0, appearance=None):
    """What is said frame by frame of a target that shows so many points."""
    appearance = appearance or Appearance()
    said = []
    for n, count in enumerate(counts):
        appearance.note(round((start_s + n / hz) * 1e9), count, MAX_GAP)
        said.append(appearance.entering_view)
    return appearance, said


def test_what_was_never_away_does_not_emerge():
    assert outcome_text([1000, 2000, 500, 3000])[1] == [False] * 4


@pytest.mark.parametrize('hz', [10.0, 30.0])
def test_it_emerges_after_a_gap_until_it_stops_growing(hz):
    appearance, _ = outcome_text([2000] * 5, hz)
    frames = round(0.5 * hz)
    grows = [round(2000 * (n + 1) / frames) for n in range(frames)]
    _, said = outcome_text(grows + [2000] * round(0.3 * hz), hz, 3.0, appearance)
    assert all(said[: frames - 1])
    assert not any(said[frames + round(0.1 * hz) :])


def test_what_grows_for_long_is_turning():
    appearance, _ = outcome_text([2000] * 5)
    _, said = outcome_text([300 * 1.1**n for n in range(30)], 10.0, 3.0, appearance)
    register_to_model = said.index(False)
    assert register_to_model == round(LONGEST_EMERGING_NS * 1e-9 * 10) + 1
    assert not any(said[register_to_model:])


SETTINGS = OdometrySettings()
S = 1_000_000_000


def hides(occlusion, stamp_ns, **values):
    has_unoccluded_reference = values.pop('has_unoccluded_reference', True)
    return occlusion.hides(
        dataclasses.replace(fit(**values), has_unoccluded_reference=has_unoccluded_reference),
        stamp_ns,
        SETTINGS,
    )


@pytest.fixture
def view(recording):
    view = recording.views[0]
    yield view
    view.unoccluded = True


def test_a_whole_view_tells_what_is_missing():
    occlusion = Occlusion()
    assert hides(occlusion, S, missing_reference_ratio=0.1)
    assert not hides(occlusion, S, missing_reference_ratio=0.02)


def test_without_a_whole_view_what_hid_a_part_is_still_there_for_a_while(view):
    occlusion = Occlusion()
    assert not hides(occlusion, S, has_unoccluded_reference=False)  # nothing was ever seen as a whole
    occlusion.take(view, fit().filter)
    seen = view.frame.stamp_ns
    assert hides(occlusion, seen + LONGEST_OCCLUSION_NS - 1, has_unoccluded_reference=False)
    assert not hides(occlusion, seen + LONGEST_OCCLUSION_NS, has_unoccluded_reference=False)
    assert not hides(occlusion, seen + S, has_unoccluded_reference=True)


def test_the_latest_half_hidden_views_serve(view):
    occlusion, motion = Occlusion(), fit().filter
    view.unoccluded = False
    for _ in range(PARTIAL_VIEWS + 3):
        occlusion.take(view, motion)
    assert len(occlusion.partial) == PARTIAL_VIEWS
    assert occlusion.last_unoccluded() is None
    np.testing.assert_allclose(occlusion.partial[0][1], inverse(motion.T_sensor_target))


def test_what_was_taken_for_whole_is_uncovered(view):
    occlusion = Occlusion()
    occlusion.take(view, fit().filter)
    occlusion.uncover([(view, np.eye(4))])
    assert not view.unoccluded
    assert occlusion.entering_view
    assert occlusion.last_unoccluded() is None
    assert occlusion.partial == [(view, occlusion.partial[0][1])]


def test_poses_follow_the_target_frame(view):
    occlusion, motion = Occlusion(), fit().filter
    view.unoccluded = False
    occlusion.take(view, motion)
    view.unoccluded = True
    occlusion.take(view, motion)
    before, T = (
        occlusion.last_unoccluded()[0].T_sensor_target,
        transform(np.eye(3), np.array([0.1, 0.2, 0.3])),
    )
    occlusion.change_target_frame(T)
    np.testing.assert_allclose(occlusion.last_unoccluded()[0].T_sensor_target @ T, before, atol=1e-12)
    np.testing.assert_allclose(occlusion.partial[0][1], T @ inverse(motion.T_sensor_target), atol=1e-12)
