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

"""The parts of the bench, each a table and its figures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmarks.performance import live, ours, python_peers, soak, tracked, whole_scan
from benchmarks.performance.measure import Cost, Row
from benchmarks.performance.pcl_peer import LUM_OUTER, PclMissing, PclPeer
from benchmarks.performance.report import number, ratios, table
from benchmarks.performance.scene import edges_of, pair_shots, whole_turn
from benchmarks.performance.searching import over_edges, over_frames, over_points, plot, search

ROOT = Path(__file__).resolve().parents[2]
RECORDING = ROOT / 'bags' / 'shuttle_stack_spin'
ONE_CLOSURE, MANY = 77, 1155
Part = tuple[str, Sequence[Any]]


@dataclass
class Bench:
    """Where things go, and how long things may take."""

    out: Path
    quick: bool
    pictures: Path

    @property
    def times(self) -> int:
        """Runs of what takes milliseconds."""
        return 20 if self.quick else 100

    @cached_property
    def pcl(self) -> PclPeer | None:
        """The built peer, or None with a word why."""
        try:
            return PclPeer(self.out / 'pcl')
        except PclMissing as missing:
            print(f'without PCL: {missing}')
            return None


def stages(bench: Bench) -> Part:
    """Each stage of ours by itself, then within a scan; PCL's counterparts."""
    shots = pair_shots(12)
    rows = ours.frame_stages(shots[0], bench.times) + ours.verification(shots, bench.times)
    rows += ours.refinement(whole_turn(), bench.times)
    if bench.pcl:
        rows += bench.pcl.stages(shots[0], whole_turn()[::6], 10 if bench.quick else 30)
    done = whole_scan.scan(RECORDING)
    end_to_end = [
        Row('a frame, scanning', ours.OURS, done.scanning, 'mean in place of the median'),
        Row('a frame, tracking', ours.OURS, done.tracking, 'mean in place of the median'),
        Row(
            'closure to model',
            ours.OURS,
            Cost.of([done.generation_ms]),
            f'{done.keyframes} key frames in the end',
        ),
        Row('last optimisation', ours.OURS, Cost.of([done.finish_ms]), f'{done.peak_mb:.0f} MB at most'),
    ]
    parts = [table(rows), 'Within a scan of `bags/shuttle_stack_spin`:', table(done.rows + end_to_end)]
    return '\n\n'.join(parts), rows + done.rows + end_to_end


def pairs(bench: Bench) -> Part:
    """Depth frame to registered pose, beside the peers, with the error of each; a striped cylinder, too."""
    count = 6 if bench.quick else 24
    shots, striped = pair_shots(count), pair_shots(count, 'cylinder', colour=True)
    rows, coloured = ours.pairs(shots), ours.pairs(striped, 'coloured')
    rows += ratios(
        python_peers.pairs(shots) + (bench.pcl.pairs(shots) if bench.pcl else []), rows[0].cost.median_ms
    )
    coloured += ratios(python_peers.coloured_pairs(striped), coloured[0].cost.median_ms)
    return table(rows + coloured), rows + coloured


def tracked_frames(bench: Bench) -> Part:
    """Frames tracked by a mesh that is known to begin with, each recording beside a pair of small_gicp."""
    rows, lines = [], [tracked.HEAD]
    for recording in tracked.recordings(tracked.FRAMES // 2 if bench.quick else tracked.FRAMES):
        rows.append(recording)
        lines.append(recording.line(tracked.unit_ms()))
    return '\n'.join(lines), rows


def relaxation(bench: Bench) -> Part:
    """77 frames of 12 000 points from drifted poses, with one closure and with over 1 000 edges."""
    shots, rows = whole_turn(), []
    for count, name in ((ONE_CLOSURE, '77 edges, one closure'), (MANY, f'{MANY} edges')):
        edges = edges_of(shots, count)
        mine = ours.relaxation(shots, edges, name)
        peers = [] if bench.quick and count == MANY else python_peers.pose_graph(shots, edges, name)
        if bench.pcl and not (bench.quick and count == MANY):
            outer = LUM_OUTER if count == ONE_CLOSURE and not bench.quick else 1
            peers.append(bench.pcl.lum(shots, edges, name, outer))
        rows += [mine, *ratios(peers, mine.cost.median_ms)]
    return table(rows), rows


def searching(bench: Bench) -> Part:
    """Comparisons and the whole search among 100, 1 000 and 10 000 key frames."""
    rows = search(pair_shots(12), bench.times)
    return table(rows), rows


def curves(bench: Bench) -> Part:
    """Cost against key frames, edges and pixels, as a plot."""
    counts = (77, 231, 462) if bench.quick else (77, 154, 308, 616, 1155)
    frames = over_frames(search(pair_shots(12), bench.times))
    edges, points = over_edges(counts), over_points()
    path = bench.pictures / 'performance.svg'
    plot(path, [('key frames searched', frames), ('edges relaxed', edges), ('pixels of the target', points)])
    return f'![Cost against key frames, edges and pixels]({path.name})', [*frames, *edges, *points]


def live_scan(bench: Bench) -> Part:
    """The real nodes over DDS at 30 Hz: depth images and coloured clouds, four processes and one."""
    seconds = 25.0 if bench.quick else live.SECONDS
    bag = live.make_recording(bench.out / f'spin_{seconds:.0f}s', seconds)
    runs = [live.depth_images, live.clouds]
    costs = [run(bag, bench.out / 'live', composed) for composed in (False, True) for run in runs]
    return live_table(costs), costs


def loaded(bench: Bench) -> Part:
    """The same beside one and two endless loops."""
    seconds = 25.0 if bench.quick else live.SECONDS
    bag = live.make_recording(bench.out / f'spin_{seconds:.0f}s', seconds)
    runs: list[tuple[Callable[..., live.LiveCost], bool]] = [
        (live.depth_images, False),
        (live.depth_images, True),
        (live.clouds, False),
    ]
    costs = []
    for loops in (1, 2):
        with live.busy_loops(loops):
            of_these = [run(bag, bench.out / 'live', composed) for run, composed in runs]
        costs += [replace(cost, name=f'{cost.name}, {loops} loop{"s"[: loops - 1]}') for cost in of_these]
    return live_table(costs), costs


def long_tumble(bench: Bench) -> Part:
    """A tumble of ten minutes at 30 Hz through the real nodes, twice."""
    minutes = 2.0 if bench.quick else live.MINUTES
    bag = live.make_recording(bench.out / f'tumble_{minutes:.0f}min', 60 * minutes, motion='tumble')
    costs = [live.depth_images(bag, bench.out / 'live') for _ in range(2)]
    return live_table(costs), costs


def live_table(costs: Sequence[live.LiveCost]) -> str:
    """One column a run."""
    rows: list[tuple[str, Callable[[live.LiveCost], str]]] = [
        ('frames shed / lost', lambda c: f'{c.shed} / {c.lost} of {c.sent}'),
        ('longest between two frames, s', lambda c: f'{c.gap_s:.2f}'),
        ('latency p50 / p99, ms', lambda c: f'{c.latency_p50:.0f} / {c.latency_p99:.0f}'),
        ('CPU of all nodes, cores', lambda c: f'{c.total_cpu:.2f}'),
        ('closure accepted to model, s', lambda c: f'{c.closure_to_model_s:.1f}'),
        ('result; attitude, deg; model, mm', lambda c: f'{c.result}; {c.attitude_deg:.3f}; {c.model_mm:.3f}'),
        ('memory at most, shared pages once, MB', lambda c: f'{max(c.memory):.0f}'),
        ('load of the machine before', lambda c: f'{c.load:.1f}'),
    ]
    head = '| | ' + ' | '.join(c.name for c in costs) + ' |\n' + '|---' * (len(costs) + 1) + '|'
    return '\n'.join(
        [head, *(f'| {name} | ' + ' | '.join(cell(c) for c in costs) + ' |' for name, cell in rows)]
    )


def soaking(bench: Bench) -> Part:
    """Memory over a ten-minute tumble at 30 Hz and over an hour of spin, as fast as the machine goes."""
    runs = soak.all_runs(bench.out, bench.quick)
    lines = ['| run | after | frames | key frames | stored | resident, MB | ms a frame |', '|---' * 7 + '|']
    for run in runs:
        lines += [
            f'| {run.name} | {s.minutes:.1f} min | {s.frames} | {s.keyframes} | {s.stored} '
            f'| {s.resident_mb:.0f} | {number(s.frame_ms)} |'
            for s in run.samples[1::2]
        ]
    return '\n'.join(lines), runs


PARTS: dict[str, Callable[[Bench], Part]] = {
    'stages': stages,
    'pairs': pairs,
    'tracked': tracked_frames,
    'relaxation': relaxation,
    'search': searching,
    'growth': curves,
    'live': live_scan,
    'loaded': loaded,
    'tumble': long_tumble,
    'soak': soaking,
}
LONG = ('tumble', 'soak')  # a quarter of an hour each, and more
DEFAULT = tuple(name for name in PARTS if name not in LONG)
