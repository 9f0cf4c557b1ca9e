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

"""Greedy and frugal search, and the graphs closed by them."""

import dataclasses

import numpy as np
import pytest
from candidate_turns import SECOND, indices, turn

from debris_scanner.core.geometry import exp_so3, rotation_angle
from debris_scanner.core.parameters import updated
from debris_scanner.mapping.closure_search import Candidate
from debris_scanner.mapping.descriptors import float_similarity
from debris_scanner.mapping.frame_graph import FrameEdge
from debris_scanner.research.thesis.loop_closures import (
    ClosureProbabilities,
    SearchThresholds,
    closed_graphs,
    frugal,
    greedy,
    hypotheses,
    open_graph,
    probabilities,
    similarities,
)
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.settings import SIMILARITIES


def test_greedy_takes_all_half_a_turn_back_and_the_directly_preceding(full_turn):
    # Frame 18 is exactly half a turn back; 33 is directly preceding but not alike; 30 and 32 are too near.
    assert indices(greedy(*full_turn)) == [0, 1, 2, 16, 17, 18, 34, 35]


def test_greedy_without_preceding_frames(full_turn):
    found = greedy(*full_turn, SearchThresholds(preceding=0))
    assert indices(found) == [0, 1, 2, 16, 17, 18]


def test_frugal_takes_the_best_half_a_turn_back(full_turn):
    best = frugal(*full_turn)
    assert best == Candidate(18, 18 * SECOND, 0.98)
    assert frugal(*full_turn, SearchThresholds(min_turn=np.radians(350.0))).index == 0


def test_nothing_probable_is_no_closure():
    arrays = turn(np.full(36, 0.79))
    assert frugal(*arrays) is None
    assert greedy(*arrays) == []


def test_threshold_itself_is_accepted():
    arrays = turn(np.full(36, 0.8))
    assert frugal(*arrays).index == 0
    assert len(greedy(*arrays)) == 19 + 3


def test_fewer_earlier_frames_than_preceding_ones():
    assert indices(greedy(*turn([0.9, 0.9]))) == [0, 1]


def test_nothing_earlier():
    arrays = turn([])
    assert greedy(*arrays) == []
    assert frugal(*arrays) is None


def test_inputs_are_left_alone(full_turn):
    before = [np.copy(a) for a in full_turn]
    for search in (greedy, frugal):
        search(*full_turn)
    for a, b in zip(before, full_turn, strict=True):
        np.testing.assert_array_equal(a, b)


@dataclasses.dataclass
class Stamped:
    stamp_ns: int


def ring(n, missing=()):
    """Odometry of n frames a fifth of a second apart, of which some are missing; ten degrees each."""
    present = [k for k in range(n) if k not in missing]
    return Odometry(
        clouds=[Stamped(k * 200_000_000) for k in present],
        observations=[],
        alignments=[],
        attitudes=[exp_so3(np.array([0, np.radians(10) * k, 0])) for k in present],
        poses=[],
        path=np.radians(10) * np.array(present, float),
        rates=[],
        kept=list(range(len(present))),
    )


def histograms(n=12, seed=0):
    h = np.random.default_rng(seed).gamma(0.5, size=(n, 180))
    return h / h.sum(axis=1, keepdims=True)


@pytest.mark.parametrize('kind', SIMILARITIES)
def test_similarity_compares_with_earlier_frames_only(kind):
    h = histograms()
    h[7] = h[2]
    P = similarities(h, kind)
    assert np.isnan(P[np.triu_indices(12)]).all()
    lower = P[np.tril_indices(12, -1)]
    assert ((lower >= 0) & (lower <= 1)).all()
    assert P[7, 2] == np.nanmax(P[7])
    if kind != 'normalised':
        assert P[7, 2] == 1.0


def test_kinds_differ_and_float_is_that_of_the_module():
    h = histograms()
    P = {kind: similarities(h, kind)[np.tril_indices(12, -1)] for kind in SIMILARITIES}
    for a in SIMILARITIES:
        for b in SIMILARITIES:
            assert a == b or not np.allclose(P[a], P[b]), (a, b)
    assert np.allclose(similarities(h, 'float')[5, :5], float_similarity(h[5], h[:5]))


def test_normalised_knows_only_the_past():
    h = histograms()
    assert np.array_equal(
        similarities(h, 'normalised')[:8, :8], similarities(h[:8], 'normalised'), equal_nan=True
    )


def test_joint_probability_peaks_where_the_same_face_returns(turning, turning_odometry, coarse):
    p = probabilities(turning_odometry, coarse)
    _, truth = turning
    last = len(p.stamps) - 1
    seen = [rotation_angle(truth[p.stamps[last]][:3, :3].T @ truth[s][:3, :3]) for s in p.stamps[:last]]
    half = last // 2
    best = int(np.nanargmax(p.joint[last, :half]))
    assert np.degrees(seen[best]) < 25
    assert np.allclose(p.joint[last, :last] ** 2, p.similarity[last, :last] * p.attitude[last, :last])


def test_consecutive_frames_are_linked_within_one_and_a_half_periods(coarse):
    whole = open_graph(ring(10), coarse)
    assert len(whole.edges()) == 9
    torn = open_graph(ring(10, missing=(4,)), coarse)  # two periods between 3 and 5
    assert len(torn.edges()) == 7
    assert [len(i) for i in torn.islands()] == [5, 4]


def test_kept_frames_far_apart_in_time_are_linked_while_data_flow(coarse):
    motion = dataclasses.replace(ring(12), kept=[0, 3, 6, 9])
    assert len(open_graph(motion, coarse).edges()) == 3
    gap = dataclasses.replace(ring(13, missing=(4,)), kept=[0, 3, 6, 9])
    assert len(open_graph(gap, coarse).edges()) == 2


def made_up(motion, joint):
    return ClosureProbabilities([c.stamp_ns for c in motion.clouds], joint, joint, joint)


def test_frugal_ranks_and_greedy_takes_all_half_a_turn_back(coarse):
    motion = ring(40)
    joint = np.full((40, 40), np.nan)
    joint[np.tril_indices(40, -1)] = 0.1
    joint[36, 0], joint[37, 1], joint[38, 30], joint[39, 38] = 0.9, 0.95, 0.99, 0.97
    joint[39, 20] = 0.85  # 190 degrees back
    frugal = hypotheses(made_up(motion, joint), motion, coarse)
    ns = 200_000_000
    assert [(e.later_ns // ns, e.earlier_ns // ns) for e in frugal] == [(37, 1), (36, 0), (39, 20)]
    greedy = hypotheses(made_up(motion, joint), motion, updated(coarse, {'closure.search': 'greedy'}))
    assert [(e.later_ns // ns, e.earlier_ns // ns) for e in greedy] == [(36, 0), (37, 1), (39, 20), (39, 38)]


def test_next_hypothesis_when_the_best_breaks_in_pruning(coarse):
    motion = ring(20, missing=(5,))
    graph = open_graph(motion, coarse)
    ns = 200_000_000
    across, within = FrameEdge(2 * ns, 18 * ns, 0.99), FrameEdge(7 * ns, 19 * ns, 0.9)
    tried = list(closed_graphs(graph, [across, within], 'frugal'))
    assert [closures for _, _, closures in tried] == [[within]]
    before, after, _ = tried[0]
    assert len(before) == 19
    assert after.stamps == [k * ns for k in range(7, 20)]


def test_greedy_has_one_hypothesis_and_nothing_comes_without_a_loop(coarse):
    motion = ring(20)
    graph = open_graph(motion, coarse)
    ns = 200_000_000
    edges = [FrameEdge(0, 15 * ns, 0.9), FrameEdge(1 * ns, 17 * ns, 0.9)]
    ((before, after, used),) = closed_graphs(graph, edges, 'greedy')
    assert used == edges
    assert len(before.edges()) == 21
    assert after.stamps == [k * ns for k in range(18)]
    assert list(closed_graphs(graph, [], 'greedy')) == []
    assert list(closed_graphs(graph, [], 'frugal')) == []
