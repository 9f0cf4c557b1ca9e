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

"""Figures 4.7, 4.8, 4.12 and 4.13: the probability of closure of one frame against all earlier ones."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from debris_scanner.research.reproduce.drawing import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    Drawn,
    axes,
    save,
    seconds,
)
from debris_scanner.research.reproduce.likeness import MEASURE_NAMES, Likeness
from debris_scanner.research.thesis.settings import SIMILARITIES

COLOURS: Mapping[str, str] = {
    'float': ORANGE,
    'binary_median': BLUE,
    'binary_mean': SKY,
    'binary_per_bin': GREEN,
    'normalised': PURPLE,
}


def likeness_figures(
    likeness: Likeness, folder: Path, numbers: tuple[str, str], named: str, threshold: float
) -> list[Drawn]:
    """P_s of a late frame by all measures, and the joint probability.

    Args:
        likeness: of the run.
        folder: for the figures.
        numbers: of the two figures in the thesis.
        named: the experiment, for the files' names.
        threshold: P_closure,min of the preset.
    """
    row = chosen_row(likeness)
    return [
        _similarity(likeness, row, folder, numbers[0], named),
        _joint(likeness, row, folder, numbers[1], named, threshold),
    ]


def chosen_row(likeness: Likeness) -> int:
    """The last frame that truly comes back to an earlier view after half a turn, else the last of all."""
    back = np.flatnonzero((likeness.same & likeness.apart).any(axis=1))
    return int(back[-1]) if len(back) else len(likeness.stamps) - 1


def _similarity(likeness: Likeness, row: int, folder: Path, number: str, named: str) -> Drawn:
    figure, (axis,) = axes(height=3.6)
    t = seconds(likeness.stamps[:row].tolist(), int(likeness.stamps[0]))
    words = []
    _mark_same(axis, likeness, row)
    for kind in SIMILARITIES:
        values = likeness.similarity[kind][row, :row]
        axis.plot(t, values, color=COLOURS[kind], lw=1.4, label=MEASURE_NAMES[kind])
        words.append(f'{kind.replace("_", " ")} {values.mean():.2f} ± {values.std():.2f}')
    axis.set(xlabel='time of the earlier frame, s', ylabel='$P_s$', ylim=(-0.02, 1.02))
    axis.legend(ncols=3, frameon=False, fontsize=8, loc='lower left')
    return save(
        figure,
        folder,
        number,
        f'similarity_{named}',
        f'Likeness of frame {row} to every earlier one; grey where the face is truly the same. '
        f'Mean and spread: {", ".join(words)}.',
    )


def _joint(likeness: Likeness, row: int, folder: Path, number: str, named: str, threshold: float) -> Drawn:
    figure, (axis,) = axes(height=3.6)
    t = seconds(likeness.stamps[:row].tolist(), int(likeness.stamps[0]))
    _mark_same(axis, likeness, row)
    axis.plot(t, likeness.attitude[row, :row], color=RED, lw=1.2, ls=':', label=r'attitude $P_\beta$')
    for kind in ('float', 'binary_median', 'binary_per_bin', 'normalised'):
        joint = likeness.joint(kind)[row, :row]
        axis.plot(t, joint, color=COLOURS[kind], lw=1.4, label=f'joint, {MEASURE_NAMES[kind]}')
    axis.axhline(threshold, color=INK, lw=0.8, ls='--')
    axis.set(xlabel='time of the earlier frame, s', ylabel='$P_{closure}$', ylim=(-0.02, 1.02))
    axis.legend(ncols=2, frameon=False, fontsize=8, loc='lower left')
    return save(
        figure,
        folder,
        number,
        f'joint_{named}',
        f'Joint probability of closure of frame {row} with every earlier one. Dashed: $P_{{closure,min}}$ '
        f'= {threshold:g} of the preset.',
    )


def _mark_same(axis: Axes, likeness: Likeness, row: int) -> None:
    t = seconds(likeness.stamps.tolist(), int(likeness.stamps[0]))
    half = float(np.median(np.diff(t))) / 2
    for k in np.flatnonzero(likeness.same[row, :row]):
        axis.axvspan(t[k] - half, t[k] + half, color=GREY, alpha=0.25, lw=0)
