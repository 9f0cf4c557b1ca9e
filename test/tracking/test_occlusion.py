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

"""Occlusion: a target that enters the view, partial occlusion, and the references used meanwhile."""

import dataclasses

import numpy as np
import pytest
from frame_fits import fit

from debris_scanner.core.geometry import inverse, transform
from debris_scanner.tracking.gating import OdometrySettings, ScanLevel
from debris_scanner.tracking.occlusion import (
    LONGEST_ENTRY_NS,
    LONGEST_OCCLUSION_NS,
    PARTIAL_VIEWS,
    Occlusion,
    ViewEntry,
)

MAX_GAP = 0.35
SETTINGS = OdometrySettings()
S = 1_000_000_000


def entering(counts, hz=10.0, start_s=0.0, entry=None):
    """Whether a target that shows so many points, frame by frame, is entering the view in each frame."""
    entry = entry or ViewEntry()
    found = []
    for n, count in enumerate(counts):
        entry.add(round((start_s + n / hz) * 1e9), count, MAX_GAP)
        found.append(entry.entering_view)
    return entry, found


def test_a_target_that_stays_in_view_is_not_entering_it():
    assert entering([1000, 2000, 500, 3000])[1] == [False] * 4


@pytest.mark.parametrize('hz', [10.0, 30.0])
def test_after_a_gap_it_is_entering_until_it_stops_growing(hz):
    entry, _ = entering([2000] * 5, hz)
    frames = round(0.5 * hz)
    grows = [round(2000 * (n + 1) / frames) for n in range(frames)]
    _, found = entering(grows + [2000] * round(0.3 * hz), hz, 3.0, entry)
    assert all(found[: frames - 1])
    assert not any(found[frames + round(0.1 * hz) :])


def test_what_grows_for_long_is_turning():
    entry, _ = entering([2000] * 5)
    _, found = entering([300 * 1.1**n for n in range(30)], 10.0, 3.0, entry)
    entered = found.index(False)
    assert entered == round(LONGEST_ENTRY_NS * 1e-9 * 10) + 1
    assert not any(found[entered:])


def hides(occlusion, stamp_ns, level=None, **values):
    has_unoccluded_reference = values.pop('has_unoccluded_reference', True)
    return occlusion.hides(
        dataclasses.replace(fit(**values), has_unoccluded_reference=has_unoccluded_reference),
        level or ScanLevel(),
        stamp_ns,
        SETTINGS,
    )


@pytest.fixture
def view(recording):
    view = recording.views[0]
    yield view
    view.unoccluded = True


def test_an_unoccluded_view_reveals_what_is_missing():
    occlusion = Occlusion()
    assert hides(occlusion, S, missing_reference_ratio=0.1)
    assert not hides(occlusion, S, missing_reference_ratio=0.02)


def test_what_every_frame_lacks_is_no_occlusion():
    """A sensor that loses the rim, or large steps: 7 % of each reference lie beside the silhouette."""
    level = ScanLevel()
    for _ in range(10):
        level.add(dataclasses.replace(fit(missing_reference_ratio=0.07), has_unoccluded_reference=True), True)
    assert not hides(Occlusion(), S, level, missing_reference_ratio=0.1)
    assert hides(Occlusion(), S, level, missing_reference_ratio=0.13)


def test_without_an_unoccluded_view_an_occlusion_lasts_for_a_while(view):
    occlusion = Occlusion()
    assert not hides(occlusion, S, has_unoccluded_reference=False)  # there never was an unoccluded view
    occlusion.keep(view, fit().filter)
    seen = view.frame.stamp_ns
    assert hides(occlusion, seen + LONGEST_OCCLUSION_NS - 1, has_unoccluded_reference=False)
    assert not hides(occlusion, seen + LONGEST_OCCLUSION_NS, has_unoccluded_reference=False)
    assert not hides(occlusion, seen + S, has_unoccluded_reference=True)


def test_the_latest_partially_occluded_views_serve(view):
    occlusion, motion = Occlusion(), fit().filter
    view.unoccluded = False
    for _ in range(PARTIAL_VIEWS + 3):
        occlusion.keep(view, motion)
    assert len(occlusion.partial) == PARTIAL_VIEWS
    assert occlusion.last_unoccluded() is None
    np.testing.assert_allclose(occlusion.partial[0][1], inverse(motion.T_sensor_target))


def test_references_that_counted_as_unoccluded_are_marked(view):
    occlusion = Occlusion()
    occlusion.keep(view, fit().filter)
    occlusion.mark_occluded([(view, np.eye(4))])
    assert not view.unoccluded
    assert occlusion.entering_view
    assert occlusion.last_unoccluded() is None
    assert occlusion.partial == [(view, occlusion.partial[0][1])]


def test_poses_follow_the_target_frame(view):
    occlusion, motion = Occlusion(), fit().filter
    view.unoccluded = False
    occlusion.keep(view, motion)
    view.unoccluded = True
    occlusion.keep(view, motion)
    before, T = (
        occlusion.last_unoccluded()[0].T_sensor_target,
        transform(np.eye(3), np.array([0.1, 0.2, 0.3])),
    )
    occlusion.change_target_frame(T)
    np.testing.assert_allclose(occlusion.last_unoccluded()[0].T_sensor_target @ T, before, atol=1e-12)
    np.testing.assert_allclose(occlusion.partial[0][1], T @ inverse(motion.T_sensor_target), atol=1e-12)
