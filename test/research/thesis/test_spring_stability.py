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

"""Stability of the spring network: second derivatives, eigenvalues, refusals."""

import numpy as np
import pytest

from debris_scanner.core.geometry import apply, exp_se3, exp_so3, inverse, transform
from debris_scanner.research.thesis import lum
from debris_scanner.research.thesis.lum import linearised, pose_matrix, spring
from debris_scanner.research.thesis.spring_stability import assess, curvature

RNG = np.random.default_rng(12)
BODY = RNG.uniform(-0.1, 0.1, (80, 3))
BODY -= BODY.mean(axis=0)
ZERO = np.zeros((6, 6))


def turned(angle):
    return transform(exp_so3(np.array([0, angle, 0])), np.zeros(3))


def ring(misfit, frames=6, noise=1e-3):
    """Springs between consecutive frames that fit, and a closure whose points are turned by ``misfit``."""
    noisy = [BODY + noise * RNG.normal(size=BODY.shape) for _ in range(frames)]
    edges = [spring(k, k + 1, noisy[k], noisy[k + 1]) for k in range(frames - 1)]
    return [*edges, spring(frames - 1, 0, apply(turned(misfit), noisy[-1]), noisy[0])]


def test_curvature_is_the_second_derivative_of_the_energy():
    A, B = (transform(exp_so3(RNG.normal(size=3)), 0.1 * RNG.normal(size=3)) for _ in range(2))
    edge = spring(0, 1, BODY, BODY[::-1])

    def energy(x):
        def twist(v):  # (translation, turns about x, z, y) to (rotation, translation)
            return np.array([v[3], v[5], v[4], v[0], v[1], v[2]])

        moved = exp_se3(twist(x[:6])) @ A, exp_se3(twist(x[6:])) @ B
        return 0.5 * linearised(edge, *moved)[2]

    h, eye = 1e-4, np.eye(12)
    numeric = np.empty((12, 12))
    for i in range(12):
        for j in range(12):
            signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
            numeric[i, j] = sum(a * b * energy(h * (a * eye[i] + b * eye[j])) for a, b in signs) / (4 * h * h)
    assert np.allclose(curvature(edge, A, B), numeric, atol=2e-5)


def test_a_ring_that_fits_is_stable_and_its_eigenvalues_are_minus_one():
    verdict = assess(ring(0.05), ZERO)
    assert verdict.stable
    assert verdict.reason is None
    assert np.allclose(verdict.eigenvalues, -1.0, atol=0.1)
    assert verdict.eigenvalues.shape == (30,)
    assert verdict.condition < 1e4


@pytest.mark.parametrize(('angle', 'stable'), [(0.5, True), (1.2, True), (1.9, False), (np.pi - 0.02, False)])
def test_two_frames_held_by_springs_turned_against_each_other(angle, stable):
    """The curvature of one spring about its axis is the cosine of the misfit: zero at a right angle."""
    pair = [spring(0, 1, BODY, apply(turned(angle), BODY))]
    verdict = assess(pair, np.zeros((2, 6)), stiffness=[1e6])
    assert verdict.stable is stable
    if not stable:
        assert 'unstable' in verdict.reason
        assert 'frame 1' in verdict.reason
        assert verdict.eigenvalues[-1] > -0.1


def test_a_closure_by_half_a_turn_makes_the_ring_unstable_when_it_is_stiff():
    edges = ring(np.pi - 0.05)
    assert not assess(edges, ZERO, stiffness=[1e6] * 6).stable
    # Lu-Milios makes it soft, since its residual is large: then the chain holds against it.
    assert assess(edges, ZERO).eigenvalues[-1] > assess(ring(0.05), ZERO).eigenvalues[-1]


def test_verdict_foretells_what_a_step_does_to_an_error():
    """e' = A e: with all stiffnesses equal, one relaxation step leaves (I + A) of a small error."""
    edges = ring(0.0, noise=1e-3)
    rest = lum.relax_fixed(edges, ZERO, 60, 1e-13)
    verdict = assess(edges, rest)
    pushed = rest.copy()
    pushed[1:] += 1e-4 * RNG.normal(size=(5, 6))
    after = lum.relax_fixed(edges, pushed, 1, 0.0)
    left = np.linalg.norm(after - rest) / np.linalg.norm(pushed - rest)
    slowest = np.abs(1 + verdict.eigenvalues).max()
    assert left < 10 * slowest + 0.01
    assert slowest < 0.1


def test_points_along_a_line_leave_the_roll_undetermined():
    line = np.outer(np.linspace(-0.1, 0.1, 60), [1.0, 0, 0])
    verdict = assess([spring(0, 1, line, line)], np.zeros((2, 6)))
    assert not verdict.stable
    assert 'undetermined' in verdict.reason
    assert verdict.condition > 1e8


def test_negative_stiffness_and_a_broken_network_are_refused_with_the_reason():
    edges = ring(0.0)
    for bad in (-1e6, 0.0, np.nan):
        verdict = assess(edges, ZERO, stiffness=[1e6, bad, 1e6, 1e6, 1e6, 1e6])
        assert not verdict.stable
        assert 'stiffness' in verdict.reason
    broken = assess(edges[1:-1], ZERO)
    assert not broken.stable
    assert 'parts' in broken.reason


def test_a_real_network_is_stable(golden):
    z = np.load(golden / 'lum_elch.npz')
    clouds = np.split(z['lum_points'], z['lum_offset'][1:-1])
    pairs = np.split(z['lum_corr'], z['lum_corr_offset'][1:-1])
    edges = [
        spring(int(s), int(t), clouds[s][c[:, 0]], clouds[t][c[:, 1]])
        for (s, t), c in zip(z['lum_edges'], pairs, strict=True)
    ]
    verdict = assess(edges, np.zeros((46, 6)))
    assert verdict.stable, verdict.reason
    assert len(verdict.eigenvalues) == 270


def test_single_frame_is_stable():
    assert assess([], np.zeros((1, 6))).stable


def test_start_may_be_away_from_zero():
    poses = 0.02 * RNG.normal(size=(6, 6))
    poses[0] = 0
    clouds = [apply(inverse(pose_matrix(p)), BODY) for p in poses]
    edges = [spring(k, (k + 1) % 6, clouds[k], clouds[(k + 1) % 6] + 1e-4) for k in range(6)]
    assert assess(edges, poses).stable
