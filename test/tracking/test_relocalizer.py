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

"""Which pose hypothesis is accepted when a target is found again: the only one, the leading one, or none yet.

What the search finds, and the hypotheses' later scores, are scripted here; ``test_odometry`` runs the real
search.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, rotation_angle
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.tracking import relocalizer
from debris_scanner.tracking.gating import STRICT, FrameFit, OdometrySettings, ScanLevel
from debris_scanner.tracking.motion_filter import ATTITUDE, OMEGA, MotionFilter, MotionSettings
from debris_scanner.tracking.relocalizer import (
    CONFIRMED,
    DECIDED_AFTER_NS,
    LONGEST_AMBIGUITY_NS,
    LONGEST_SCANNING_NS,
    PoseHypothesis,
    Relocalizer,
)

STEP_NS = 100_000_000
USUAL = 0.5  # nats, loss of right frames
PASSES = 0.78  # overlap of a scripted fit whose loss is the strict gate's bound
DIRECTIONS = np.random.default_rng(0).normal(size=(500, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
SURFACE = SimpleNamespace(points=DIRECTIONS * [0.1, 0.12, 0.2], normals=DIRECTIONS)
LEFT = DIRECTIONS[:, 0] > -0.2  # of which the right side was never seen
HALF = SimpleNamespace(points=SURFACE.points[LEFT], normals=DIRECTIONS[LEFT])


def motion(turn_deg=0.0, sigma_deg=15.0, rate_sigma=None):
    made = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
    if rate_sigma is not None:
        made.P[OMEGA, OMEGA] = np.eye(3) * rate_sigma**2
    made.R = exp_so3(np.radians([0.0, 0.0, turn_deg]))
    made.P[ATTITUDE, ATTITUDE] = np.eye(3) * np.radians(sigma_deg) ** 2
    return made


def fit(turn_deg, overlap, missing_reference_ratio=0.0, observability=0.1, rate_sigma=None):
    stats = RegistrationStats(points=1000, matched=950, visible=1000)
    loss = USUAL + STRICT * OdometrySettings().max_loss + PASSES - overlap
    moved = motion(turn_deg, rate_sigma=rate_sigma)
    return FrameFit(
        moved, stats, observability, overlap, overlap, missing_reference_ratio, True, loss, loss
    )  # fmt: skip


def level():
    made = ScanLevel()
    for _ in range(10):
        made.add(dataclasses.replace(fit(0, 0.95), loss=USUAL), unoccluded=True)
    return made


def local_map(surface=None):
    known = [(SURFACE, np.eye(4))]
    return SimpleNamespace(
        references=lambda _: known, level=level(), surface=surface, settings=OdometrySettings(), stretch=1.0
    )


def frame(n, late_ns=0):
    stamp_ns = 1_000_000_000 + n * STEP_NS + late_ns
    return SimpleNamespace(picture=None, frame=SimpleNamespace(stamp_ns=stamp_ns))


@pytest.fixture
def play(monkeypatch):
    """Plays a script: what searches near and everywhere find, and later overlaps of each hypothesis."""

    def played(
        near, later=None, everywhere=(), surface=None, sigma_deg=15.0, frames=40, known=0.9, search_s=0.0
    ):
        later = later or {}
        searched = []

        def search(_predicted, _view, starts, _references, _share):
            searched.append(len(starts))
            return list(near if len(searched) == 1 or not everywhere else everywhere)

        def follow(moved, _view, _references, _gates):
            turn = round(np.degrees(rotation_angle(moved.R)))
            return fit(turn, later.get(turn, 0.95))

        monkeypatch.setattr(relocalizer, 'search', search)
        monkeypatch.setattr(relocalizer, 'fit_frame', follow)
        monkeypatch.setattr(relocalizer, 'global_pose_search', lambda _surface, _view: [np.eye(4)])
        monkeypatch.setattr(relocalizer, 'mapped_fraction', lambda _references, _view, _pose: known)
        monkeypatch.setattr(relocalizer, '_flips', lambda _surface: [])
        made = Relocalizer(local_map(surface))
        for n in range(frames):
            late_ns = round(1e9 * search_s * len(searched))  # frames that passed meanwhile
            found = made.find(motion(0.0, sigma_deg), frame(n, late_ns), True)
            if found is not None:
                turn = round(np.degrees(rotation_angle(found.filter.R)))
                return turn, n * STEP_NS, made
        return None, None, made

    return played


def test_the_only_one_is_accepted_at_once(play):
    turn, after_ns, made = play([fit(5, 0.95), fit(7, 0.94), fit(40, 0.8)], sigma_deg=4.0)
    assert (turn, after_ns, made.ambiguous, made.consistent_with_prediction) == (5, 0, False, True)


def test_where_the_prediction_is_unsure_even_the_only_one_is_followed_first(play):
    fits = [fit(5, 0.95), fit(40, 0.8)]
    assert play(fits, sigma_deg=12.0)[:2] == (5, (CONFIRMED - 1) * STEP_NS)
    assert play(fits, {5: 0.5}, sigma_deg=12.0)[0] is None


def test_a_search_may_take_longer_than_frames_do(play):
    """A slow machine sees nothing for 1.4 s: what it found is followed as far as its rates reach."""
    assert play([fit(5, 0.95, rate_sigma=0.1)], sigma_deg=12.0, search_s=1.4)[0] == 5
    assert play([fit(5, 0.95, rate_sigma=1.0)], sigma_deg=12.0, search_s=1.4)[0] is None


def test_fits_that_slide_along_a_face_are_none(play):
    slides = [fit(5, 0.95, observability=0.0004), fit(8, 0.9, observability=0.0004)]
    assert play(slides, sigma_deg=12.0)[0] is None
    assert play(slides[:1], sigma_deg=12.0)[0] == 5  # from all starts the same
    assert play(slides, sigma_deg=4.0)[0] == 5
    assert play(slides, sigma_deg=12.0, surface=SURFACE)[0] == 5


def test_what_matches_less_than_half_is_not_enough(play):
    """The frame shows the unmapped back of a model whose mapped front it matches only at the rim."""
    assert play([fit(5, 0.95)], sigma_deg=12.0, surface=SURFACE, known=0.03)[0] is None
    assert play([fit(5, 0.95)], sigma_deg=4.0, surface=SURFACE, known=0.03)[0] == 5  # the prediction is sure
    assert play([fit(5, 0.95)], sigma_deg=12.0, known=0.44)[0] is None  # nor is it without a model


def test_of_two_the_one_that_keeps_fitting_better_is_accepted(play):
    turn, after_ns, made = play([fit(20, 0.96), fit(5, 0.95)], {20: 0.90, 5: 0.95})
    assert turn == 5
    assert DECIDED_AFTER_NS <= after_ns < LONGEST_AMBIGUITY_NS
    assert (made.ambiguous, made.consistent_with_prediction) == (False, True)


def test_one_that_is_contradicted_leaves_the_other(play):
    turn, after_ns, _ = play([fit(20, 0.96), fit(5, 0.95)], {20: 0.5})
    assert (turn, after_ns) == (5, (CONFIRMED - 1) * STEP_NS)


def test_distance_from_the_prediction_is_penalised(play):
    """Four hundredths better, but three sigma off."""
    assert play([fit(45, 0.97), fit(0, 0.95)], {45: 0.97})[0] == 0


def test_of_indistinguishable_ones_the_nearest_is_taken_as_ambiguous(play):
    turn, after_ns, made = play([fit(20, 0.95), fit(5, 0.95)], {20: 0.963, 5: 0.95}, surface=SURFACE)
    assert (turn, after_ns) == (5, LONGEST_AMBIGUITY_NS)
    assert made.ambiguous
    assert not made.consistent_with_prediction  # no frame of it enters a model


def test_without_a_model_hypotheses_are_tracked_for_longer_and_then_searched_again(play):
    script = ([fit(20, 0.95), fit(5, 0.95)], {20: 0.963, 5: 0.95})
    turn, _, made = play(*script, frames=LONGEST_SCANNING_NS // STEP_NS)
    assert turn is None and len(made._hypotheses[0].scores) == LONGEST_SCANNING_NS // STEP_NS
    turn, _, made = play(*script, frames=LONGEST_SCANNING_NS // STEP_NS + 1)
    assert turn is None and len(made._hypotheses[0].scores) == 1


def test_without_a_model_a_small_lead_stays_one_however_often_it_is_seen(play):
    """The upper stage, 72 degrees off and 60: neither matches much, one a hundredth more."""
    near = [fit(20, 0.95), fit(5, 0.95)]
    assert play(near, {20: 0.86, 5: 0.88})[0] is None
    assert play(near, {20: 0.86, 5: 0.88}, surface=SURFACE)[0] == 5
    assert play(near, {20: 0.86, 5: 0.95})[0] == 5


def test_without_a_model_one_that_fails_by_a_hair_is_not_contradicted(play):
    near = [fit(20, 0.95), fit(5, 0.95)]
    hair = {20: PASSES - 0.005, 5: PASSES + 0.005}
    assert play(near, hair)[0] is None
    assert play(near, hair, surface=SURFACE)[0] == 5
    assert play(near, hair | {20: PASSES - 0.05})[0] == 5


def test_what_fails_the_gate_now_is_not_accepted_for_having_led(monkeypatch):
    later = {20: PASSES - 0.005, 5: PASSES + 0.005}

    def turned(moved):
        return round(np.degrees(rotation_angle(moved.R)))

    monkeypatch.setattr(relocalizer, 'fit_frame', lambda m, *_: fit(turned(m), later[turned(m)]))
    made = Relocalizer(local_map())
    made._hypotheses = [
        PoseHypothesis(fit(20, 0.95), 0.0, [0.95] * 4),
        PoseHypothesis(fit(5, 0.85), 0.0, [0.85] * 4),
    ]
    made._since_ns, made._stamp_ns = frame(0).frame.stamp_ns, frame(4).frame.stamp_ns
    assert made.find(motion(), frame(5), True) is None
    assert [turned(r.fit.filter) for r in made._hypotheses] == [20, 5]


def test_the_best_itself_must_pass_the_strict_gate(play):
    """The one that scores best is contradicted, and what scores worse may not stand in for it."""
    contradicted = dataclasses.replace(fit(5, 1.0), loss=USUAL + 1.0)
    assert play([contradicted, fit(40, 0.85)])[0] is None


def test_a_face_of_a_box_is_not_taken_for_the_next(play):
    assert play([fit(90, 0.98)], sigma_deg=29.0)[0] is None


def test_without_a_prediction_appearance_decides_and_is_not_consistent_with_it(play):
    turn, _, made = play([fit(5, 0.5)], everywhere=[fit(120, 0.97)], surface=SURFACE, sigma_deg=60.0)
    assert (turn, made.consistent_with_prediction, made.ambiguous) == (120, False, False)
    assert play([fit(5, 0.5)], everywhere=[fit(120, 0.97)], sigma_deg=60.0)[0] is None


@pytest.mark.parametrize(('surface', 'found'), [(SURFACE, 95), (HALF, None)])
def test_appearance_does_not_decide_where_the_opposite_side_is_unmapped(play, surface, found):
    """The model lacks that side, so a frame of it matches the opposite side best."""
    seen = fit(95, 0.97)
    seen.filter.R = exp_so3(np.radians([0.0, 95.0, 0.0]))
    assert play([fit(5, 0.5)], everywhere=[seen], surface=surface, sigma_deg=60.0)[0] == found
