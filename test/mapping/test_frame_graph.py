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

"""Links, cycles and pruning of the frame graph, against an enumeration of all cycles."""

import networkx as nx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from processor_time import processor_seconds

from debris_scanner.mapping.frame_graph import FrameEdge, FrameGraph, FrameGraphSettings, close_first_loop

PERIOD = 200_000_000  # 5 Hz


def chain(count, closures=(), gaps=(), directed=False):
    """Graph of frames 0..count-1 (stamps in sampling periods), with gaps after the frames given."""
    graph = FrameGraph(FrameGraphSettings(directed=directed))
    for k in range(count):
        graph.add_frame(k * PERIOD, linked=k - 1 not in gaps)
    for a, b in closures:
        graph.add_closure(a * PERIOD, b * PERIOD, 0.9)
    return graph


def frames(stamps):
    return [s // PERIOD for s in stamps]


def test_consecutive_frames_are_linked_within_one_and_a_half_periods():
    graph = FrameGraph(FrameGraphSettings(sampling_period=0.2))
    for stamp in (0, PERIOD, PERIOD + int(1.5 * PERIOD), PERIOD * 5):
        graph.add_frame(stamp)
    assert [(e.earlier_ns, e.later_ns) for e in graph.edges()] == [(0, PERIOD), (PERIOD, int(2.5 * PERIOD))]


def test_caller_may_force_or_forbid_a_link():
    graph = FrameGraph()
    graph.add_frame(0)
    graph.add_frame(100 * PERIOD, linked=True)
    graph.add_frame(101 * PERIOD, linked=False)
    assert graph.edges() == [FrameEdge(0, 100 * PERIOD, None)]


def test_edges_name_closures_by_their_probability():
    graph = chain(3)
    graph.add_closure(0, 2 * PERIOD, 0.87)
    assert graph.edges()[1] == FrameEdge(0, 2 * PERIOD, 0.87)


def test_refuses_frames_out_of_order_and_closures_of_unknown_frames():
    graph = chain(3)
    with pytest.raises(ValueError, match='not newer'):
        graph.add_frame(2 * PERIOD)
    for a, b in ((2, 0), (1, 1), (0, 7)):
        with pytest.raises(ValueError, match='no closure possible'):
            graph.add_closure(a * PERIOD, b * PERIOD, 0.9)


@pytest.mark.parametrize('directed', [False, True])
def test_pruning_drops_the_loose_ends_of_the_thesis_figure(directed):
    # Trowbridge 2014, fig. 2.3 and eq. 2.1-2.3: frames 0, 41, 42 and 43 are on no cycle.
    graph = chain(44, [(1, 40), (2, 39)], directed=directed)
    assert frames(graph.prune().stamps) == list(range(1, 41))
    assert len(graph) == 44  # the graph itself is left alone


@pytest.mark.parametrize('directed', [False, True])
def test_pruning_without_closure_leaves_nothing(directed):
    pruned = chain(20, directed=directed).prune()
    assert len(pruned) == 0
    assert pruned.prune().stamps == []


def test_pruning_keeps_the_largest_island():
    graph = chain(30, [(0, 9), (12, 28)], gaps=[10])
    assert frames(graph.prune().stamps) == list(range(12, 29))


def test_equal_islands_keep_the_earlier():
    assert frames(chain(10, [(0, 4), (5, 9)], gaps=[4]).prune().stamps) == [0, 1, 2, 3, 4]


def test_the_bridge_between_two_loops_breaks_and_the_larger_loop_stays():
    # Frames 5..8 link the loops without being on one; once they go, the loops are islands.
    graph = chain(20, [(0, 4), (9, 19)])
    assert frames(graph.prune().stamps) == list(range(9, 20))


def test_closures_across_a_gap_hold_two_segments_only_without_direction():
    closures = [(2, 12), (6, 18)]
    assert frames(chain(20, closures, gaps=[9]).prune().stamps) == [*range(2, 7), *range(12, 19)]
    assert len(chain(20, closures, gaps=[9], directed=True).prune()) == 0


def test_closure_beside_a_consecutive_edge_is_no_loop():
    assert len(chain(5, [(1, 2)]).prune()) == 0
    assert frames(chain(5, [(1, 2)], directed=True).prune().stamps) == [1, 2]


def test_frames_know_their_cycles():
    graph = chain(10, [(0, 4), (4, 8)])
    assert [frames(g) for g in graph.cycles()] == [[0, 1, 2, 3, 4], [4, 5, 6, 7, 8]]
    assert graph.on_same_cycle(0, 4 * PERIOD)
    assert not graph.on_same_cycle(0, 8 * PERIOD)


def test_frames_can_follow_a_pruned_graph():
    pruned = chain(10, [(2, 6)]).prune()
    pruned.add_frame(10 * PERIOD, linked=True)  # the frame before it was pruned away: no link
    assert frames(pruned.stamps) == [2, 3, 4, 5, 6, 10]
    assert len(pruned.islands()) == 2


def test_next_hypothesis_is_tried_when_the_best_does_not_close_a_loop():
    graph = chain(30, gaps=[20])
    across = FrameEdge(0, 25 * PERIOD, 0.99)
    small = FrameEdge(3 * PERIOD, 12 * PERIOD, 0.85)
    pruned, chosen = close_first_loop(graph, [across, small])
    assert chosen == small
    assert frames(pruned.stamps) == list(range(3, 13))
    assert close_first_loop(graph, [across]) is None
    with pytest.raises(ValueError, match='no closure'):
        close_first_loop(graph, [FrameEdge(0, PERIOD, None)])


@st.composite
def random_graphs(draw):
    n = draw(st.integers(1, 14))
    gaps = draw(st.sets(st.integers(0, n), max_size=3))
    pairs = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda p: p[0] < p[1])
    closures = draw(st.lists(pairs, max_size=6)) if n > 1 else []
    return n, closures, gaps


def edge_list(graph, directed):
    edges = graph.edges()
    if directed:
        pairs = [(e.later_ns, e.earlier_ns) if e.probability else (e.earlier_ns, e.later_ns) for e in edges]
        plain = nx.DiGraph(pairs)
    else:
        plain = nx.Graph([(e.earlier_ns, e.later_ns) for e in edges])
    plain.add_nodes_from(graph.stamps)
    return plain


def brute_force_cycles(plain):
    return [c for c in nx.simple_cycles(plain) if len(c) >= (2 if plain.is_directed() else 3)]


@settings(derandomize=True, max_examples=150, deadline=None)
@given(random_graphs(), st.booleans())
def test_cycle_search_equals_the_enumeration_of_all_cycles(drawn, directed):
    graph = chain(*drawn, directed=directed)
    every = brute_force_cycles(edge_list(graph, directed))
    grouped = {stamp for group in graph.cycles() for stamp in group}
    assert grouped == {stamp for cycle in every for stamp in cycle}
    for cycle in every:  # each lies wholly within one group
        assert graph.on_same_cycle(cycle[0], cycle[-1])


@settings(derandomize=True, max_examples=150, deadline=None)
@given(random_graphs(), st.booleans())
def test_pruning_leaves_one_island_of_frames_on_cycles(drawn, directed):
    graph = chain(*drawn, directed=directed)
    pruned = graph.prune()
    plain = edge_list(pruned, directed)
    on_cycle = {stamp for c in brute_force_cycles(plain) for stamp in c}
    assert set(pruned.stamps) == on_cycle
    assert len(pruned.islands()) <= 1
    assert pruned.prune().edges() == pruned.edges()
    original = graph.edges()
    assert pruned.edges() == [e for e in original if e.earlier_ns in pruned and e.later_ns in pruned]


@pytest.mark.timing
def test_a_thousand_frames_and_closures_take_a_moment():
    closures = [(k, (k * 7919 + 13) % 1000) for k in range(1000)]
    graph = chain(1000, [(min(c), max(c)) for c in closures if c[0] != c[1]])
    best = processor_seconds(lambda: (graph.prune(), graph.cycles()))
    assert best < 0.5  # measured below 0.05 s; the rest is for a busy machine
