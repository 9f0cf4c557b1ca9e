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

"""Graph of key frames: odometry links, loop closures, cycles and pruning.

Trowbridge 2014, sections 2.1, 2.3 and 3.2, eq. 2.28 and 2.29. Frames are named by their stamps. An edge
between consecutive frames points forward in time and exists only where no data gap separates them; a
closure points from the later frame back to the earlier one, so that going round is a directed cycle.

By default cycles ignore direction, because a relaxation acts on both ends of an edge: two segments of frames
with a gap between them, tied by two closures, constrain each other although no directed cycle runs through
them. ``directed`` restores the thesis's definition.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from debris_scanner.core.parameters import parameter

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True)
class FrameGraphSettings:
    """When consecutive frames are linked, and what counts as a cycle."""

    sampling_period: float = parameter(0.2, 'time between frames while data flows', 's', 0.0)
    max_gap: float = parameter(
        1.5, 'longest time between linked consecutive frames, in sampling periods', '', 0.0
    )
    directed: bool = parameter(
        False, 'follow edges only forwards when looking for cycles, as the thesis does'
    )


@dataclass(frozen=True)
class FrameEdge:
    """Link between two frames; ``probability`` is None between consecutive frames."""

    earlier_ns: int
    later_ns: int
    probability: float | None


class FrameGraph:
    """Key frames and their links. Frames arrive in order of time, closures in any order."""

    def __init__(self, settings: FrameGraphSettings | None = None) -> None:
        self.settings = settings or FrameGraphSettings()
        self._graph = _networkx().DiGraph()
        self._last_ns: int | None = None

    def __len__(self) -> int:
        return len(self._graph)

    def __contains__(self, stamp_ns: int) -> bool:
        return stamp_ns in self._graph

    @property
    def stamps(self) -> list[int]:
        """All frames in order of time."""
        return sorted(self._graph)

    def edges(self) -> list[FrameEdge]:
        """All links, by the later and then the earlier frame; consecutive before closure."""
        links = [
            FrameEdge(min(a, b), max(a, b), probability)
            for a, b, probability in self._graph.edges(data='probability')
        ]
        return sorted(links, key=lambda e: (e.later_ns, e.earlier_ns, e.probability is not None))

    def copy(self) -> 'FrameGraph':
        """Independent copy, on which to try a hypothesis."""
        return self._restricted(self._graph)

    def add_frame(self, stamp_ns: int, linked: bool | None = None) -> None:
        """Add the newest key frame.

        ``linked`` says whether an edge leads to it from the frame before; None decides by the time
        between them, eq. 2.28.

        Raises:
            ValueError: if the frame is not newer than all before.
        """
        last = self._last_ns
        if last is not None and stamp_ns <= last:
            raise ValueError(f'frame {stamp_ns} is not newer than {last}')
        self._graph.add_node(stamp_ns)
        self._last_ns = stamp_ns
        if last is None or last not in self._graph:
            return
        if linked is None:
            linked = (stamp_ns - last) * 1e-9 <= self.settings.max_gap * self.settings.sampling_period + 1e-9
        if linked:
            self._graph.add_edge(last, stamp_ns, probability=None)

    def add_closure(self, earlier_ns: int, later_ns: int, probability: float) -> None:
        """Link two frames that show the same face, eq. 2.29.

        Raises:
            ValueError: if the order of the two is wrong or either is not in the graph.
        """
        if earlier_ns >= later_ns or earlier_ns not in self._graph or later_ns not in self._graph:
            raise ValueError(f'no closure possible between frames {earlier_ns} and {later_ns}')
        self._graph.add_edge(later_ns, earlier_ns, probability=probability)

    def islands(self) -> list[set[int]]:
        """Connected groups of frames, the largest first; of equals the earliest first."""
        groups = _networkx().weakly_connected_components(self._graph)
        return sorted(groups, key=lambda g: (-len(g), min(g)))

    def cycles(self) -> list[list[int]]:
        """Groups of frames on common cycles, each in order of time, by their first frames.

        Undirected, any two frames of a group share a cycle, and a frame where two such groups meet
        belongs to both (biconnected components); directed, every frame of a group can be reached from
        every other (strongly connected components). Both take time linear in frames and edges.
        """
        if self.settings.directed:
            groups = [g for g in _networkx().strongly_connected_components(self._graph) if len(g) > 1]
        else:
            groups = [g for g in _networkx().biconnected_components(self._undirected()) if len(g) > 2]
        return sorted(sorted(g) for g in groups)

    def on_same_cycle(self, a_ns: int, b_ns: int) -> bool:
        """Whether some cycle group holds both frames."""
        return any(a_ns in group and b_ns in group for group in self.cycles())

    def prune(self) -> 'FrameGraph':
        """Copy of the largest island without frames on no cycle, repeated until stable or empty.

        Trowbridge 2014, section 3.2: only on cycles can a relaxation distribute the error.
        """
        kept = self.copy()
        while len(kept):
            island = kept._restricted(kept.islands()[0])
            on_cycle = {stamp for group in island.cycles() for stamp in group}
            if len(on_cycle) == len(kept):
                break
            kept = island._restricted(on_cycle)
        return kept

    def _undirected(self) -> 'nx.Graph':
        graph = _networkx().Graph()
        graph.add_nodes_from(self._graph)
        graph.add_edges_from(self._graph.edges)  # a closure parallel to a consecutive edge merges with it
        return graph

    def _restricted(self, stamps: Iterable[int]) -> 'FrameGraph':
        part = FrameGraph(self.settings)
        part._graph = self._graph.subgraph(stamps).copy()
        part._last_ns = self._last_ns
        return part


def close_first_loop(graph: FrameGraph, closures: Iterable[FrameEdge]) -> tuple[FrameGraph, FrameEdge] | None:
    """Pruned graph and closure of the first hypothesis whose loop survives pruning, or None.

    Hypotheses are tried one at a time, in the order given, each on a copy of ``graph``. The thesis stopped
    when its best closure failed, and asks for the next ones to be tried (Trowbridge 2014, 6.2.6).

    Raises:
        ValueError: for a closure without probability or between frames that are not in the graph.
    """
    for closure in closures:
        if closure.probability is None:
            raise ValueError(f'{closure} is no closure: it has no probability')
        attempt = graph.copy()
        attempt.add_closure(closure.earlier_ns, closure.later_ns, closure.probability)
        pruned = attempt.prune()
        if pruned.on_same_cycle(closure.earlier_ns, closure.later_ns):
            return pruned, closure
    return None


def _networkx() -> Any:
    """The library, loaded late: of all stages of a live scan one alone needs its 12 MB."""
    import networkx

    return networkx
