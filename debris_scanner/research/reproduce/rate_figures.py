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

"""Figures 4.1, 4.2, 4.5, 4.6 and 4.15: what the estimators make of the rates, and what is left over."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from debris_scanner.core.geometry import Array, log_so3
from debris_scanner.research.reproduce.drawing import (
    AXES,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    Drawn,
    axes,
    save,
    seconds,
)
from debris_scanner.research.reproduce.methods import Runs
from debris_scanner.research.thesis.odometry import Odometry

_Truth = Mapping[int, Array]


def batch_figures(runs: Runs, truth: _Truth, folder: Path) -> list[Drawn]:
    """Post-fit residuals of the batch processor, and its state."""
    batch, clouds = runs.batch.batch, runs.batch.odometry.clouds
    t = seconds(batch.stamps, batch.start_ns)
    figure, (axis,) = axes()
    for k, colour in enumerate((BLUE, ORANGE, GREEN)):
        axis.plot(t, batch.residuals[:, k], color=colour, lw=1.2, label=f'$\\omega_{AXES[k]}$')
    axis.set(xlabel='time, s', ylabel='residual, rad/s')
    axis.legend(ncols=3, frameon=False)
    rms = np.sqrt((batch.residuals**2).mean(axis=0))
    residuals = save(
        figure,
        folder,
        '4.1',
        'batch_residuals',
        f'Post-fit residuals of the batch processor; RMS {_list(rms)} rad/s about x, y, z.',
    )
    figure, (left, right) = axes(1, 2, width=9)
    stamps = [c.stamp_ns for c in clouds]
    true = true_rates(truth, stamps)
    for k, colour in enumerate((BLUE, ORANGE, GREEN)):
        left.plot(seconds(stamps[1:], stamps[0]), true[:, k], color=colour, lw=1, alpha=0.6)
        left.axhline(batch.state[4 + k], color=colour, lw=1.8, ls='--', label=f'$\\omega_{AXES[k]}$')
    left.set(xlabel='time, s', ylabel='rate, rad/s', title='estimate dashed, truth solid')
    left.legend(frameon=False)
    turned = [np.degrees(np.linalg.norm(log_so3(batch.attitude(s)))) for s in stamps]
    first = truth[stamps[0]][:3, :3]
    really = [np.degrees(np.linalg.norm(log_so3(truth[s][:3, :3] @ first.T))) for s in stamps]
    right.plot(seconds(stamps, stamps[0]), turned, color=RED, label='batch processor')
    right.plot(seconds(stamps, stamps[0]), really, color=GREY, ls='--', label='truth')
    right.set(xlabel='time, s', ylabel='principal angle, °')
    right.legend(frameon=False)
    state = save(
        figure,
        folder,
        '4.2',
        'batch_state',
        f'State of the batch processor: one constant rate, {batch.state[5]:.4f} rad/s about y. The principal '
        'angle folds back at 180°, as in the thesis, though the target turns on.',
    )
    return [residuals, state]


def ekf_figures(runs: Runs, truth: _Truth, folder: Path, rate_number: str, named: str) -> list[Drawn]:
    """Rate of the filter with its 3σ and the observations, 4.5 or 4.15; with 4.5 the residuals, 4.6."""
    motion = runs.thesis.odometry
    assert motion is not None and motion.ekf is not None
    drawn = [_rates(motion, truth, folder, rate_number, named)]
    if rate_number == '4.5':
        drawn.append(_residuals(motion, folder))
    return drawn


def _rates(motion: Odometry, truth: _Truth, folder: Path, number: str, named: str) -> Drawn:
    steps = motion.ekf
    assert steps is not None
    stamps = [c.stamp_ns for c in motion.clouds]
    t = seconds(stamps[1:], stamps[0])
    omega, bound = np.array([s.omega for s in steps]), np.array([s.three_sigma for s in steps])
    nothing = np.full(3, np.nan)
    seen = np.array([nothing if o.omega is None else o.omega for o in motion.observations])
    out = np.array([not s.accepted for s in steps])
    true = true_rates(truth, stamps)
    figure, panels = axes(3, 1, height=6.5, share_x=True)
    for k, axis in enumerate(panels):
        axis.fill_between(
            t, omega[:, k] - bound[:, k], omega[:, k] + bound[:, k], color=BLUE, alpha=0.2, lw=0
        )
        axis.plot(t, true[:, k], color=GREY, ls='--', lw=1.2, label='truth')
        axis.plot(t, seen[:, k], '.', color=ORANGE, ms=4, label='frame to frame')
        axis.plot(t[out], seen[out, k], 'x', color=RED, ms=6, label='rejected')
        axis.plot(t, omega[:, k], color=BLUE, lw=1.4, label='filter, 3σ')
        middle, spread = np.nanmedian(seen[:, k]), 1.5 * np.nanmax(np.abs(seen - np.nanmedian(seen, axis=0)))
        axis.set(ylabel=f'$\\omega_{AXES[k]}$, rad/s', ylim=(middle - spread - 0.1, middle + spread + 0.1))
    panels[0].legend(ncols=4, frameon=False, fontsize=8)
    panels[-1].set_xlabel('time, s')
    error = np.sqrt(((omega - true)[len(true) // 4 :] ** 2).mean(axis=0))
    inside = (np.abs(omega - true) <= bound)[len(true) // 4 :].mean()
    return save(
        figure,
        folder,
        number,
        f'ekf_rate_{named}',
        f'Rate of the EKF with 3σ, and the observations from frame-to-frame ICP. After the first quarter '
        f'its RMS error is {_list(error)} rad/s about x, y, z, and {inside:.0%} of the true rates lie within '
        f'its 3σ; {int(out.sum())} of {len(out)} observations were rejected or missing.',
    )


def _residuals(motion: Odometry, folder: Path) -> Drawn:
    steps = motion.ekf
    assert steps is not None
    t = seconds([s.stamp_ns for s in steps], motion.clouds[0].stamp_ns)
    nothing = np.full(3, np.nan)
    left_over = np.array([nothing if s.residual is None else s.residual for s in steps])
    bound = np.array([s.three_sigma for s in steps])
    figure, panels = axes(3, 1, height=6.0, share_x=True)
    for k, axis in enumerate(panels):
        axis.plot(t, left_over[:, k], '.', color=BLUE, ms=4)
        axis.plot(t, bound[:, k], color=RED, lw=1)
        axis.plot(t, -bound[:, k], color=RED, lw=1)
        most = 1.3 * max(float(np.nanmax(np.abs(left_over[:, k]))), float(np.median(bound[:, k])))
        axis.set(ylabel=f'residual {AXES[k]}, rad/s', ylim=(-most, most))
    panels[-1].set_xlabel('time, s')
    rms = np.sqrt(np.nanmean(left_over**2, axis=0))
    return save(
        figure,
        folder,
        '4.6',
        'ekf_residuals',
        f'Post-fit residuals of the EKF, RMS {_list(rms)} rad/s; red: 3σ.',
    )


def true_rates(truth: _Truth, stamps: list[int]) -> Array:
    """Mean true rates (n - 1, 3) between frames, along the sensor's axes as ICP observes them, rad/s."""
    rates = []
    for before, after in pairwise(stamps):
        R = truth[after][:3, :3] @ truth[before][:3, :3].T
        rates.append(log_so3(R) / ((after - before) * 1e-9))
    return np.array(rates)


def _list(values: Array) -> str:
    return ', '.join(f'{v:.2g}' for v in values)
