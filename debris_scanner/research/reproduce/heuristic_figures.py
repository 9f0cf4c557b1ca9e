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

"""Figures 5.4 to 5.9 and the ROC: the similarities over all pairs of frames (T29)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from debris_scanner.mapping.descriptors import SIZE
from debris_scanner.report.discrimination import entropy_bits
from debris_scanner.research.reproduce.drawing import BLUE, GREY, INK, ORANGE, RED, Drawn, axes, save
from debris_scanner.research.reproduce.heuristics import Pool
from debris_scanner.research.reproduce.likeness import MEASURE_NAMES, Likeness
from debris_scanner.research.reproduce.likeness_figures import COLOURS
from debris_scanner.research.thesis.settings import SIMILARITIES

_BINS = np.linspace(0, 1, 65)


def heuristic_figures(runs: Sequence[Likeness], folder: Path) -> list[Drawn]:
    """All of them; ``runs`` are those with the shuttle, the first of which 5.5 and 5.6 are drawn from."""
    late, apart = Pool.of(runs, late=True), Pool.of(runs, late=False)
    first = Pool.of(runs[:1], late=True)
    drawn = [
        _histograms(late, ('float', 'binary_median'), False, folder, '5.4', 'binary_and_float'),
        _quantisation(runs[0], folder),
        _histograms(first, ('binary_median', 'binary_mean'), False, folder, '5.6', 'median_and_mean'),
        _histograms(late, ('float', 'binary_median'), True, folder, '5.7', 'joint'),
        _histograms(
            late, ('binary_median', 'binary_mean', 'binary_per_bin'), True, folder, '5.8', 'thresholds'
        ),
        _histograms(late, ('float', 'normalised'), False, folder, '5.9', 'float_and_normalised'),
    ]
    curves = _curves(apart, folder)
    return drawn if curves is None else [*drawn, curves]


def _histograms(pool: Pool, kinds: Sequence[str], joint: bool, folder: Path, number: str, name: str) -> Drawn:
    figure, (axis,) = axes()
    words = []
    for kind in kinds:
        values = (pool.joint if joint else pool.similarity)[kind]
        label = f'{MEASURE_NAMES[kind]}: {entropy_bits(values):.2f} bit'
        axis.hist(values, _BINS.tolist(), histtype='stepfilled', alpha=0.45, color=COLOURS[kind], label=label)
        words.append(f'{kind.replace("_", " ")} {values.mean():.2f} ± {values.std():.2f}')
    axis.set(xlabel='$P_{closure}$' if joint else '$P_s$', ylabel='pairs', xlim=(0, 1))
    axis.legend(frameon=False, loc='upper left')
    what = 'Joint probability' if joint else 'Similarity'
    return save(
        figure,
        folder,
        number,
        name,
        f'{what} of {len(pool.attitude)} pairs of frames, with its Shannon entropy in 64 bins. '
        f'Mean and spread: {", ".join(words)}.',
    )


def _quantisation(run: Likeness, folder: Path) -> Drawn:
    k = len(run.histograms) - 1
    histogram = run.histograms[k]
    figure, (axis,) = axes()
    axis.bar(np.arange(SIZE), histogram, width=1.0, color=GREY)
    median, mean = float(np.median(histogram)), float(histogram.mean())
    axis.axhline(median, color=BLUE, lw=1, label=f'median {median:.4f}')
    axis.axhline(mean, color=RED, lw=1, ls='--', label=f'mean {mean:.4f}')
    over = histogram > median
    axis.plot(np.flatnonzero(over), np.full(over.sum(), -0.03 * histogram.max()), '|', color=INK, ms=5)
    axis.set(xlabel='bin', ylabel='share', xlim=(-1, SIZE))
    axis.legend(frameon=False)
    return save(
        figure,
        folder,
        '5.5',
        'quantisation',
        f'EFPFH of the last frame of experiment 1 and what its binary form keeps: the marked '
        f'{int(over.sum())} of {SIZE} bins lie above its median, {int((histogram > mean).sum())} above '
        'its mean.',
    )


def _curves(pool: Pool, folder: Path) -> Drawn | None:
    attitude = pool.curve(pool.attitude)
    if attitude is None:
        return None
    figure, panels = axes(1, 2, width=9, height=4.4)
    for axis, values, title in (
        (panels[0], pool.similarity, 'similarity alone'),
        (panels[1], pool.joint, 'joined with the attitude'),
    ):
        for kind in SIMILARITIES:
            curve = pool.curve(values[kind])
            assert curve is not None
            axis.plot(curve[0], curve[1], color=COLOURS[kind], lw=1.5, label=f'{kind}: {curve[2]:.3f}')
        axis.plot([0, 1], [0, 1], color=GREY, lw=0.8, ls=':')
        axis.set(xlabel='others taken for the same', ylabel='same faces found', title=title)
    panels[1].plot(
        attitude[0], attitude[1], color=ORANGE, ls='--', lw=1, label=f'attitude: {attitude[2]:.3f}'
    )
    for axis in panels:
        axis.legend(frameon=False, fontsize=8, loc='lower right')
    return save(
        figure,
        folder,
        '5.9',
        'roc',
        f'ROC of every similarity over the {len(pool.same)} pairs with at least half a turn in between, '
        f'{int(pool.same.sum())} of which show the same face (true attitudes within 10°); the area under '
        'each curve is beside its name. The thesis has no such figure: it argued from distributions alone.',
    )
