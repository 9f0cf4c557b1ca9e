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

"""Figures 4.3, 4.4, 4.9-4.11, 4.14, 4.17 and 2.14: models, views that look alike, and the sensor's way."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from debris_scanner.core.geometry import Array, apply, compose, inverse
from debris_scanner.evaluation.trajectory_errors import align, by_stamp
from debris_scanner.research.reproduce.drawing import (
    BLUE,
    GREY,
    ORANGE,
    Drawn,
    axes,
    draw_cloud,
    draw_surface,
    save,
    seconds,
)
from debris_scanner.research.reproduce.likeness import Likeness
from debris_scanner.research.reproduce.methods import METHOD_NAMES, METHODS, ODOMETRY_ONLY, OURS, THESIS, Runs
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.sim.motions import Motion

_Truth = Mapping[int, Array]
# Axes across and up, seen from the positive third: the target's long axis is its z.
_SIDE, _FRONT, _END = (1, 2, 'from the side'), (2, 0, 'from the front'), (0, 1, 'from the end')


def model_figures(runs: Runs, truth: _Truth, folder: Path, experiment: str) -> list[Drawn]:
    """The models that correspond to the thesis's, each moved onto the truth by the one constant alignment."""
    if experiment == '1':
        return [
            _model(
                runs,
                truth,
                folder,
                '4.3',
                ODOMETRY_ONLY,
                'batch_model',
                'Model by the batch processor alone.',
            ),
            _model(runs, truth, folder, '4.4', THESIS, 'thesis_model', "Model of the thesis's method."),
            comparison(runs, truth, folder, '4.9', experiment),
        ]
    if experiment == '2':
        return [comparison(runs, truth, folder, '4.14', experiment)]
    return [comparison(runs, truth, folder, '4.17' if experiment == '3' else '2.14', experiment)]


def _model(runs: Runs, truth: _Truth, folder: Path, number: str, method: str, name: str, text: str) -> Drawn:
    figure, panels = axes(1, 2, width=8, height=5)
    _draw(panels, placed(runs, truth, method), (_SIDE, _END), '')
    return save(figure, folder, number, name, text)


def comparison(runs: Runs, truth: _Truth, folder: Path, number: str, experiment: str) -> Drawn:
    """The three models side by side."""
    figure, panels = axes(2, 3, width=9.5, height=7.5)
    views = (_FRONT if experiment == '2' else _SIDE, _END)
    for k, method in enumerate(METHODS):
        _draw([panels[k], panels[3 + k]], placed(runs, truth, method), views, f'{METHOD_NAMES[method]}, ')
    return save(
        figure,
        folder,
        number,
        f'models_{experiment}',
        f'Models of the three methods in experiment {experiment}, {views[0][2]} and {views[1][2]}.',
    )


def _draw(
    panels: Sequence[Axes],
    surface: tuple[Array, Array] | None,
    views: Sequence[tuple[int, int, str]],
    prefix: str,
) -> None:
    for axis, (across, up, title) in zip(panels, views, strict=True):
        axis.set_title(prefix + title, fontsize=9)
        if surface is None:
            axis.text(0.5, 0.5, 'no model', ha='center', transform=axis.transAxes)
        else:
            draw_surface(axis, *surface, across, up)


def placed(runs: Runs, truth: _Truth, method: str) -> tuple[Array, Array] | None:
    """Points and normals (n, 3) of a method's model in the true target frame; None where it has none."""
    model = runs.results[method].model
    if model is None:
        return None
    T = align(truth, by_stamp(runs.results[method].poses))
    return apply(T, model.points), model.normals @ T[:3, :3].T


def look_alike_figure(likeness: Likeness, motion: Odometry, folder: Path, number: str, named: str) -> Drawn:
    """The two views that the binary EFPFH alone, without the attitude, takes for one face (4.10, 4.11)."""
    P = np.where(likeness.apart, likeness.similarity['binary_median'], -1.0)
    later, earlier = np.unravel_index(int(np.argmax(P)), P.shape)
    pair = [motion.clouds[motion.kept[int(k)]].points for k in (earlier, later)]
    figure, panels = axes(1, 2, width=8, height=4.6)
    for axis, points, k in zip(panels, pair, (earlier, later), strict=True):
        draw_cloud(axis, points - points.mean(axis=0), 0, 1, ORANGE)
        axis.invert_yaxis()  # the sensor's y points down
        axis.set_title(f'frame {int(k)}')
    right = bool(likeness.same[later, earlier])
    every = likeness.apart & (likeness.similarity['binary_median'] >= P.max() - 0.02)
    share = float(likeness.same[every].mean())
    return save(
        figure,
        folder,
        number,
        f'binary_alone_{named}',
        f'The pair that the binary EFPFH alone finds most alike, P = {P.max():.3f}: '
        f'{"truly the same face" if right else "a false positive"}. Of the {int(every.sum())} pairs '
        f'within 0.02 of it, {share:.0%} show the same face.',
    )


def track_figure(runs: Runs, truth: _Truth, motion: Motion, folder: Path, number: str, named: str) -> Drawn:
    """Where the observer was: truth, and as our final poses and the thesis's chained alignments have it."""
    stamps = sorted(truth)
    start = stamps[0]
    world = {s: inverse(motion.T_sensor_world(float((s - start) * 1e-9))) for s in stamps}
    figure, panels = axes(1, 2, width=9.5, height=4)
    tracks = {'truth': np.array([world[s][:3, 3] for s in stamps])}
    for method in (THESIS, OURS):
        poses = by_stamp(runs.results[method].poses)
        T_truth_target = align(truth, poses)
        shared = [s for s in stamps if s in poses]
        # the observer in the world: through the target's true place there, which the estimate cannot know
        found = [compose(world[s], truth[s], T_truth_target, inverse(poses[s]))[:3, 3] for s in shared]
        tracks[METHOD_NAMES[method]] = np.array(found)
    for name, colour in (('truth', GREY), (METHOD_NAMES[THESIS], ORANGE), (METHOD_NAMES[OURS], BLUE)):
        track = tracks[name] * 1e3
        style = '-' if name == 'truth' else '.'
        panels[0].plot(track[:, 0], track[:, 2], style, color=colour, ms=4, label=name)
        if name == 'truth':
            speed = np.gradient(track, seconds(stamps, start), axis=0)
            for k, axis_colour in enumerate((BLUE, ORANGE, GREY)):
                panels[1].plot(
                    seconds(stamps, start), speed[:, k], color=axis_colour, label=f'$v_{"xyz"[k]}$'
                )
    panels[0].set(xlabel='x, mm', ylabel='z, mm', aspect='equal')
    panels[0].legend(frameon=False, fontsize=8)
    panels[1].set(xlabel='time, s', ylabel='velocity of the observer, mm/s')
    panels[1].legend(frameon=False, fontsize=8)
    return save(
        figure,
        folder,
        number,
        f'observer_{named}',
        'Way of the observer seen from above, true and as estimated, and its true velocity.',
    )
