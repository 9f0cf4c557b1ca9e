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

"""One experiment from simulation to table lines and figures; its folder appears whole or not at all."""

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from debris_scanner import __version__
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import flatten
from debris_scanner.evaluation.metrics import evaluate
from debris_scanner.io.files import write_atomically
from debris_scanner.io.result_files import METRICS, write_results
from debris_scanner.research.reproduce import graph_figures, rate_figures, scores, space_figures
from debris_scanner.research.reproduce.drawing import Drawn
from debris_scanner.research.reproduce.experiments import Experiment, stage, thesis_settings
from debris_scanner.research.reproduce.likeness import Likeness
from debris_scanner.research.reproduce.likeness_figures import likeness_figures
from debris_scanner.research.reproduce.methods import Progress, Runs, run_all
from debris_scanner.research.thesis.settings import ThesisSettings
from debris_scanner.sim.motions import Motion
from debris_scanner.sim.session import Simulation, write_truth

RESULT = 'experiment.json'
LIKENESS = 'likeness.npz'
_TRUTH = 'truth'

_LIKENESS_NUMBERS = {'1': ('4.7', '4.8'), '2': ('4.12', '4.13')}


def run(experiment: Experiment, out: Path, quick: bool, progress: Progress) -> None:
    """Simulate, run the three methods, judge them, draw; leaves ``out``/experiment_KEY.

    Raises:
        ValueError: a method was given nothing that it could use.
        OSError: the folder cannot be written.
    """
    final, partial = out / experiment.folder, out / f'.{experiment.folder}.part'
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    settings = thesis_settings(experiment, quick)
    simulation = stage(experiment, quick)
    depth = _frames(simulation, progress)
    truth = {f.stamp_ns: simulation.pose(k) for k, f in enumerate(depth)}
    runs = run_all(depth, settings, progress, experiment.compares_searches)
    write_truth(partial / _TRUTH, list(truth), list(truth.values()), simulation.target)
    rows = {}
    for k, method in enumerate(runs.results):
        progress(0.9 + 0.015 * k, 'evaluation')
        rows[method] = _judge(runs, method, truth, depth, partial)
    progress(0.96, 'figures')
    likeness, drawn = _draw(experiment, runs, settings, truth, simulation.motion, partial)
    write_atomically(partial / LIKENESS, likeness.encode())
    content = {
        'stands_for': stands_for(experiment, quick),
        'title': experiment.title,
        'section': experiment.section,
        'preset': experiment.preset,
        'frames': len(depth),
        'kept_frames': len(likeness.stamps),
        'points_a_frame': round(float(np.mean([len(c.points) for c in runs.batch.odometry.clouds]))),
        'outcome': {'thesis': runs.thesis.detail, 'ours': runs.ours.reason or 'model'},
        'thesis_timing': runs.thesis.timing,
        'methods': rows,
        'figures': [asdict(d) for d in drawn],
    }
    write_atomically(partial / RESULT, (json.dumps(content, indent=2) + '\n').encode())
    shutil.rmtree(final, ignore_errors=True)
    partial.rename(final)
    progress(1.0, 'done')


def finished(experiment: Experiment, out: Path, quick: bool) -> dict[str, Any] | None:
    """What an earlier run left of the experiment, if it stands for the same settings and version."""
    path = out / experiment.folder / RESULT
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except ValueError:
        return None
    same = isinstance(content, dict) and content.get('stands_for') == stands_for(experiment, quick)
    return content if same else None


def stands_for(experiment: Experiment, quick: bool) -> dict[str, Any]:
    """Everything that the result of an experiment follows from, in a form that JSON gives back unchanged."""
    described = {
        'version': __version__,
        'simulation': asdict(stage(experiment, quick).settings),
        'wobble': experiment.wobble,
        'compares_searches': experiment.compares_searches,
        'thesis': flatten(thesis_settings(experiment, quick)),
    }
    result: dict[str, Any] = json.loads(json.dumps(described))
    return result


def _frames(simulation: Simulation, progress: Progress) -> list[DepthFrame]:
    depth = []
    for frame in simulation:
        metres = frame.depth_mm.astype(np.float32) / np.float32(1000)
        depth.append(DepthFrame(frame.stamp_ns, metres, frame.camera))
        progress(0.1 * len(depth) / len(simulation), 'simulation')
    return depth


def _judge(
    runs: Runs, method: str, truth: Mapping[int, Array], depth: list[DepthFrame], folder: Path
) -> dict[str, Any]:
    """The method's files as ``scan`` would write them, evaluated as ``evaluate`` would."""
    result = runs.results[method]
    write_results(folder / method, result, runs.wall_s[method])
    metrics = evaluate(folder / method, folder / _TRUTH, depth)
    write_atomically(folder / method / METRICS, (json.dumps(metrics, indent=2) + '\n').encode())
    keyframes_ns = [p.stamp_ns for p in result.keyframe_poses]
    return scores.row(truth, result.odometry, result.closures, keyframes_ns, metrics, runs.wall_s[method])


def _draw(
    experiment: Experiment,
    runs: Runs,
    settings: ThesisSettings,
    truth: Mapping[int, Array],
    motion: Motion,
    folder: Path,
) -> tuple[Likeness, list[Drawn]]:
    """The figures that the thesis has of this experiment, and what 5.4 to 5.9 will be drawn from."""
    key = experiment.key
    odometry = runs.batch.odometry
    likeness = Likeness.of(odometry, truth, settings.descriptor)
    drawn = space_figures.model_figures(runs, truth, folder, key)
    if key == '1':
        drawn += rate_figures.batch_figures(runs, truth, folder)
    drawn += rate_figures.ekf_figures(runs, truth, folder, '4.5' if key == '1' else '4.15', key)
    numbers = _LIKENESS_NUMBERS.get(key, ('4.7', '4.8'))
    drawn += likeness_figures(likeness, folder, numbers, key, settings.closure.min_probability)
    if key in ('1', '2'):
        number = '4.10' if key == '1' else '4.11'
        drawn.append(space_figures.look_alike_figure(likeness, odometry, folder, number, key))
    drawn.append(graph_figures.pruning_figure(runs, truth, folder, '4.16' if key == '2' else '5.2', key))
    drawn.append(graph_figures.unpruned_figure(runs, settings, truth, folder, key))
    if key in ('3', 'cw'):
        drawn.append(graph_figures.search_figure(runs, settings, truth, folder, key))
        number = '4.17' if key == '3' else '2.14'
        drawn.append(space_figures.track_figure(runs, truth, motion, folder, number, key))
    return likeness, drawn
