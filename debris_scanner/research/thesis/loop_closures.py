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

"""Loop closures in the thesis: probabilities of all kept frames, greedy and frugal search, the graph.

Trowbridge 2014, sections 2.9, 2.10, 3.2, 4.4 and 5.3, eq. 2.83, 2.84 and 2.86-2.102; thesis parts T10-T16 and
T21. The parts are the product's own modules; this is the order in which the thesis uses them. How far back
a frame lies is measured by the rotation travelled since, half a revolution being half a period. Arrays are
those of :mod:`debris_scanner.mapping.closure_search`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.mapping.closure_search import Candidate, Stamps, attitude_probability, joint_probability
from debris_scanner.mapping.descriptors import (
    PerBinThreshold,
    SimilarityWindow,
    binarise,
    binary_similarity,
    efpfh,
    float_similarity,
    hamming,
    mean_threshold,
    median_threshold,
)
from debris_scanner.mapping.frame_graph import FrameEdge, FrameGraph, FrameGraphSettings, close_first_loop
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.settings import ThesisSettings


@dataclass(frozen=True)
class SearchThresholds:
    """When an earlier frame counts as a closure."""

    min_probability: float = 0.8  # joint
    min_turn: float = float(np.pi)  # rad, rotation between the frames: half a period
    preceding: int = 3  # directly preceding key frames that greedy search may link as well


def greedy(
    stamps: Stamps,
    probabilities: Array,
    paths: Array,
    path: float,
    settings: SearchThresholds | None = None,
) -> list[Candidate]:
    """Every likely closure, in order of time, Trowbridge 2014, eq. 2.83 and section 4.4.

    Accepted are frames of sufficient probability that lie at least half a revolution back or are among the
    few directly preceding ones. Frames between them look similar merely because the target has rotated
    little; section 4.4 leaves them out, eq. 2.83 alone does not.

    Args:
        stamps: (n,) of the earlier key frames.
        probabilities: (n,) of each.
        paths: (n,) rotation travelled up to each, radians.
        path: rotation travelled up to the newest frame, radians.
        settings: thresholds.
    """
    settings = settings or SearchThresholds()
    allowed = path - paths >= settings.min_turn
    allowed[max(len(stamps) - settings.preceding, 0) :] = True
    chosen = np.flatnonzero(allowed & (probabilities >= settings.min_probability))
    return [_candidate(int(k), stamps, probabilities) for k in chosen]


def frugal(
    stamps: Stamps,
    probabilities: Array,
    paths: Array,
    path: float,
    settings: SearchThresholds | None = None,
) -> Candidate | None:
    """The single best closure at least half a revolution back, if any; arguments as :func:`greedy`.

    Trowbridge 2014, eq. 2.84. The thesis then keeps only the best one of the session: the
    maximum of these results by probability. Of equals the earliest is returned.
    """
    settings = settings or SearchThresholds()
    allowed = (path - paths >= settings.min_turn) & (probabilities >= settings.min_probability)
    if not allowed.any():
        return None
    best = np.flatnonzero(allowed)[np.argmax(probabilities[allowed])]
    return _candidate(int(best), stamps, probabilities)


@dataclass(frozen=True)
class ClosureProbabilities:
    """Row: newer frame, column: earlier one; (n, n), NaN where the column is not earlier."""

    stamps: list[int]
    similarity: Array
    attitude: Array
    joint: Array


def similarities(histograms: Array, kind: str) -> Array:
    """P_s (n, n) of histograms (n, 180) in order of time, by one of ``settings.SIMILARITIES``."""
    n = len(histograms)
    P = np.full((n, n), np.nan)
    words = None
    if kind in ('binary_median', 'normalised'):
        words = binarise(histograms, median_threshold(histograms))
    elif kind == 'binary_mean':
        words = binarise(histograms, mean_threshold(histograms))
    per_bin, window = PerBinThreshold(), SimilarityWindow()
    for k in range(n):
        if kind == 'float':
            P[k, :k] = float_similarity(histograms[k], histograms[:k])
        elif words is None:
            P[k, :k] = binary_similarity(per_bin.hamming_to_earlier(per_bin.add(histograms[k])))
        else:
            P[k, :k] = binary_similarity(hamming(words[k], words[:k]))
        if kind == 'normalised':
            # the window holds what has been seen so far, as in a live scan
            window.add(P[k, :k])
            P[k, :k] = window.normalise(P[k, :k])
    return P


def probabilities(odometry: Odometry, settings: ThesisSettings) -> ClosureProbabilities:
    """Joint probability of every pair of kept frames, eq. 2.86-2.102."""
    clouds = [odometry.clouds[k] for k in odometry.kept]
    rotations = np.array([odometry.attitudes[k] for k in odometry.kept])
    histograms = np.array([efpfh(c.points, c.normals, settings.descriptor) for c in clouds])
    similarity = similarities(histograms, settings.closure.similarity)
    attitude = np.full_like(similarity, np.nan)
    for k in range(1, len(clouds)):
        attitude[k, :k] = attitude_probability(rotations[k], rotations[:k])
    joint = joint_probability(similarity, attitude)
    return ClosureProbabilities([c.stamp_ns for c in clouds], similarity, attitude, joint)


def open_graph(odometry: Odometry, settings: ThesisSettings) -> FrameGraph:
    """Kept frames with edges between consecutive ones, unless data were missing in between (eq. 2.28)."""
    s = settings.odometry
    graph = FrameGraph(FrameGraphSettings(1.0 / s.sample_rate, s.max_gap, settings.closure.directed))
    previous = None
    for k in odometry.kept:
        stamps = [odometry.clouds[m].stamp_ns for m in range(previous or 0, k + 1)]
        longest = max(np.diff(stamps), default=0)
        unbroken = bool(longest * 1e-9 <= s.max_gap / s.sample_rate + 1e-9)
        graph.add_frame(odometry.clouds[k].stamp_ns, linked=previous is not None and unbroken)
        previous = k
    return graph


def hypotheses(p: ClosureProbabilities, odometry: Odometry, settings: ThesisSettings) -> list[FrameEdge]:
    """Closures proposed by the search: greedy in order of time, frugal the most probable first.

    Frugal search keeps one closure; the others of sufficient probability follow as further hypotheses.
    """
    rule = settings.closure
    search = SearchThresholds(
        min_probability=rule.min_probability, min_turn=2 * np.pi * rule.min_period, preceding=rule.preceding
    )
    stamps = np.array(p.stamps, np.int64)
    path = odometry.path[odometry.kept]
    found = []
    for k in range(1, len(stamps)):
        earlier = stamps[:k], p.joint[k, :k], path[:k], float(path[k])
        if rule.search == 'greedy':
            found += [FrameEdge(c.stamp_ns, int(stamps[k]), c.probability) for c in greedy(*earlier, search)]
        elif frugal(*earlier, search) is not None:
            allowed = (path[k] - path[:k] >= search.min_turn) & (p.joint[k, :k] >= search.min_probability)
            found += [
                FrameEdge(int(stamps[m]), int(stamps[k]), float(p.joint[k, m]))
                for m in np.flatnonzero(allowed)
            ]
    if rule.search == 'frugal':
        found.sort(key=lambda e: (-(e.probability or 0.0), e.later_ns, e.earlier_ns))
    return found


def closed_graphs(
    graph: FrameGraph, closures: Sequence[FrameEdge], search: str
) -> Iterator[tuple[FrameGraph, FrameGraph, list[FrameEdge]]]:
    """Graph before and after pruning with the closures in it, the best hypothesis first (T21).

    Greedy search has one hypothesis, all closures together; frugal search has one for each closure whose
    loop survives pruning. Yields nothing where no loop survives.
    """
    if search == 'greedy':
        full = graph.copy()
        for c in closures:
            full.add_closure(c.earlier_ns, c.later_ns, c.probability or 0.0)
        pruned = full.prune()
        if closures and len(pruned):
            yield full, pruned, [c for c in closures if c.earlier_ns in pruned and c.later_ns in pruned]
        return
    left = list(closures)
    while left:
        closed = close_first_loop(graph, left)
        if closed is None:
            return
        pruned, closure = closed
        full = graph.copy()
        full.add_closure(closure.earlier_ns, closure.later_ns, closure.probability or 0.0)
        yield full, pruned, [closure]
        left = left[left.index(closure) + 1 :]


def _candidate(k: int, stamps: Stamps, probabilities: Array) -> Candidate:
    return Candidate(k, int(stamps[k]), float(probabilities[k]))
