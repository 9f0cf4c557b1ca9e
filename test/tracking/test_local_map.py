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

"""The local map: what a frame is registered to, and what an accepted frame adds."""

import dataclasses

import numpy as np
import pytest
import scipy
from frame_fits import fit

from debris_scanner.core.geometry import inverse, rotation_angle
from debris_scanner.sensing.depth_offset import NO_OFFSET
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking import local_map
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.local_map import MIN_POINTS, SURPRISING, LocalMap, chance_beyond
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings

DT, MAX_GAP = 0.1, 0.35  # s
SETTINGS = OdometrySettings()


def begun(target):
    """A map of one key frame, and the filter that it was taken at."""
    made = LocalMap(SETTINGS, NormalSettings())
    view = made.prepare(target, SETTINGS, MAX_GAP, 1.0)
    motion = MotionFilter(view.centroid, MotionSettings(), view.footprint)
    made.submaps.add(view, motion)
    return made, motion


def test_a_frame_is_registered_to_the_key_frame_before(recording):
    made, motion = begun(recording.targets[0])
    view = made.prepare(recording.targets[1], SETTINGS, MAX_GAP, 1.0)
    found = made.register(motion.predicted(DT), view, motion, DT)
    first, second = (recording.truth[t.stamp_ns][:3, :3] for t in recording.targets[:2])
    assert np.degrees(rotation_angle(found.filter.R @ motion.R.T @ (second @ first.T).T)) < 0.7
    assert made.add(found, view, True) is None  # it has turned by 3 degrees
    few = dataclasses.replace(SETTINGS, keyframe_angle_deg=1.0)
    for consistent in (False, True):
        view = made.prepare(recording.targets[1], few, MAX_GAP, 1.0)
        assert (made.add(found, view, consistent) is not None) == consistent
    assert len(made.submaps.keyframes) == 2


@pytest.mark.parametrize(('surprise', 'losses'), [(1.0, [0.5]), (1e3, [0.5, 0.2]), (1e3, [0.2, 0.5])])
def test_what_surprises_is_fitted_with_released_rates_too(recording, monkeypatch, surprise, losses):
    fits = [dataclasses.replace(fit(), surprise=surprise, loss=loss) for loss in losses]
    monkeypatch.setattr(local_map, 'fit_frame', lambda *_: fits.pop(0))
    made, motion = begun(recording.targets[0])
    view = made.prepare(recording.targets[1], SETTINGS, MAX_GAP, 1.0)
    assert made.register(motion.predicted(DT), view, motion, DT).loss == min(losses)
    assert not fits


@pytest.mark.parametrize(('age_s', 'submap'), [(0.1, 1), (3.1, 0)])
def test_a_frame_that_shows_more_than_a_young_submap_begins_the_next(recording, monkeypatch, age_s, submap):
    monkeypatch.setattr(local_map, 'shows_unmapped_surface', lambda *_: True)
    made, motion = begun(recording.targets[0])
    late_ns = recording.targets[0].stamp_ns + round(age_s * 1e9)
    later = dataclasses.replace(recording.targets[1], stamp_ns=late_ns)
    view = made.prepare(later, SETTINGS, 10.0, 1.0)
    assert made.register(motion.predicted(DT), view, motion, DT) is not None
    assert (made.submaps.number, len(made.submaps.keyframes)) == (submap, 1 - submap)
    assert (view.unoccluded, len(made.occlusion.partial)) == (not submap, submap)


def test_a_target_that_enters_the_view_or_shows_too_little_is_not_searched(recording):
    made, _ = begun(recording.targets[0])
    view = made.prepare(recording.targets[1], SETTINGS, MAX_GAP, 1.0)
    assert made.shows_target(view)
    view.points = view.points[: MIN_POINTS - 1]
    assert not made.shows_target(view)
    assert not made.shows_target(made.prepare(recording.targets[20], SETTINGS, MAX_GAP, 1.0))  # after 1.9 s


def test_a_new_submap_forgets_the_model(recording, true_model):
    made, motion = begun(recording.targets[0])
    first = recording.targets[0].stamp_ns
    with pytest.raises(ValueError, match='no key frame'):
        made.adopt(true_model, {first + 1: np.eye(4)}, NO_OFFSET)
    assert made.model is None
    pose = inverse(recording.truth[first])
    T_new_old, inertia = made.adopt(true_model, {first: pose}, NO_OFFSET)
    np.testing.assert_allclose(T_new_old @ inverse(motion.T_sensor_target), pose, atol=1e-12)
    assert np.linalg.eigvalsh(inertia).min() > 0
    motion.change_target_frame(T_new_old)
    assert [surface is made.surface for surface, _ in made.references(motion)] == [False, True]
    made.begin_submap()
    assert made.model is None and made.references(motion) == []
    assert made.submaps.path_rad == np.pi


@pytest.mark.parametrize('squared', [0.0, 1.0, 6.0, 38.26, 1e5])
def test_chances_are_those_of_chi_square(squared):
    chance = chance_beyond(squared)
    assert chance == pytest.approx(scipy.special.chdtrc(6, squared), rel=1e-12)
    assert not chance_beyond(np.inf) >= SURPRISING  # no fit is kept for a distance that is no number
