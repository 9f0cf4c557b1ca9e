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

"""Closure search among ever more key frames, and how cost grows: with key frames, edges and pixels.

:func:`search` measures one comparison with all key frames, and the search up to the ranked candidates. The
``over_*`` functions return cost as curves, :func:`plot` draws them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.performance.measure import Row, repeat
from benchmarks.performance.ours import OURS, SETTINGS, pairs, relaxation
from benchmarks.performance.python_peers import pairs as peer_pairs
from benchmarks.performance.scene import Shot, edges_of, turn, whole_turn
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.mapping.closure_search import Stamps, attitude_probability, candidates, joint_probability
from debris_scanner.mapping.descriptors import (
    SIZE,
    PerBinThreshold,
    binary_similarity,
    efpfh,
    float_similarity,
    hamming,
)

COUNTS = (100, 1_000, 10_000)  # key frames searched
RANGES_M = (1.1, 0.9, 0.75, 0.65, 0.58)  # of the target: nearer, more pixels


def search(shots: list[Shot], times: int) -> list[Row]:
    """Rows ``float`` and ``binary``, comparisons alone, and ``search``, up to the ranked candidates."""
    rows = []
    for count in COUNTS:
        descriptors, histograms = _described(shots, count)
        rotations = np.array([inverse(shots[k % len(shots)].pose)[:3, :3] for k in range(count)])
        stamps, paths = np.arange(count, dtype=np.int64), np.linspace(0.0, 0.1 * count, count)

        def search_all(
            descriptors: PerBinThreshold = descriptors, rotations: Array = rotations,
            stamps: Stamps = stamps, paths: Array = paths,
        ) -> None:  # fmt: skip
            similarity = binary_similarity(descriptors.hamming_to_earlier(len(descriptors) - 1))
            attitude = attitude_probability(rotations[0], rotations[1:])
            probability = joint_probability(similarity, attitude)
            candidates(stamps[1:], probability, paths[1:], float(paths[-1]), SETTINGS.closure_search, most=2)

        tasks: dict[str, Callable[[], object]] = {
            'float EFPFH': partial(float_similarity, histograms[0], histograms),
            'binary EFPFH': partial(hamming, descriptors.words[0], descriptors.words),
            'closure search': search_all,
        }
        rows += [
            Row(f'{name}, 1 against {count}', OURS, repeat(task, times, 5)) for name, task in tasks.items()
        ]
    return rows


@dataclass
class Curve:
    """One line of a plot: cost in CPU milliseconds over a size."""

    name: str
    sizes: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    def add(self, size: float, ms: float) -> None:
        self.sizes.append(size)
        self.ms.append(ms)


def over_edges(counts: Sequence[int]) -> list[Curve]:
    """Cost of relaxing the full revolution, by edges."""
    curve = Curve('ours')
    for count in counts:
        curve.add(count, relaxation(whole_turn(), edges_of(whole_turn(), count), '').cost.median_ms)
    return [curve]


def over_points() -> list[Curve]:
    """Cost of registering a frame, by pixels of the target."""
    curves: dict[str, Curve] = {}
    for range_m in RANGES_M:
        shots = turn(8.0, 6, range_m)
        pixels = float(np.mean([(s.target.depth > 0).sum() for s in shots]))
        for row in pairs(shots) + [r for r in peer_pairs(shots) if '4 mm' in r.who]:
            curves.setdefault(row.who, Curve(row.who)).add(pixels, row.cost.median_ms)
    return list(curves.values())


def over_frames(rows: Sequence[Row]) -> list[Curve]:
    """The rows of :func:`search` as curves."""
    curves: dict[str, Curve] = {}
    for row in rows:
        name, count = row.what.split(', 1 against ')
        curves.setdefault(name, Curve(name)).add(int(count), row.cost.median_ms)
    return list(curves.values())


def plot(path: Path, panels: Sequence[tuple[str, Sequence[Curve]]]) -> None:
    """One panel for each size, both axes logarithmic."""
    import matplotlib

    matplotlib.use('svg')
    matplotlib.rcParams['svg.hashsalt'] = 'performance'  # the same figures give the same file
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(panels), figsize=(4.4 * len(panels), 3.8), layout='constrained')
    for axis, (label, curves) in zip(axes, panels, strict=True):
        for curve in curves:
            axis.loglog(curve.sizes, curve.ms, 'o-', markersize=4, linewidth=1.5, label=curve.name)
        axis.set_xlabel(label)
        axis.set_ylabel('CPU time, ms')
        axis.grid(visible=True, which='both', alpha=0.2)
        axis.legend(fontsize=7, frameon=False)
    figure.savefig(path, metadata={'Date': None})
    plt.close(figure)


def _described(shots: list[Shot], count: int) -> tuple[PerBinThreshold, Array]:
    """Descriptors of ``count`` key frames: those of the shots, repeated with noise."""
    random = np.random.default_rng(0)
    real = np.array([efpfh(s.view.points, s.view.normals) for s in shots])
    noise = random.normal(1.0, 0.1, (count, SIZE)).clip(0.5, 1.5)
    histograms = (real[np.arange(count) % len(real)] * noise).astype(np.float32)
    histograms /= histograms.sum(axis=1, keepdims=True)
    descriptors = PerBinThreshold()
    for histogram in histograms:
        descriptors.add(histogram)
    return descriptors, histograms
