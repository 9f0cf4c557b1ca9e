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

"""How soon and how well a known model is found and tracked.

Each target is scanned once, in a spin; that model is then looked for in another recording of the target, from
a random moment on, and in one of the next target of the list, where it must be refused. Errors are against
the simulator's truth, up to turns after which the model looks the same.

python -m benchmarks.known_models [TARGET ...] [--motions spin tumble] [--store FOLDER]

Models and finished rows are kept in the store, and not made again.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from debris_scanner.core.frames import DepthFrame, Model
from debris_scanner.core.geometry import Array, compose, inverse, rotation_angle
from debris_scanner.evaluation.trajectory_errors import align, by_stamp
from debris_scanner.io.files import write_atomically
from debris_scanner.io.known_models import read_known_model
from debris_scanner.io.result_files import write_results
from debris_scanner.modelling.symmetry import SHARE, turns_onto_itself
from debris_scanner.scanner import Scanner
from debris_scanner.sim.motions import MOTION_NAMES
from debris_scanner.sim.session import SimulatedFrame, Simulation, SimulationSettings
from debris_scanner.sim.targets import TARGET_NAMES

SCANNED_S = 15.0  # of a spin, for the model
TRACKED_S = 18.0  # of the other recording
LATEST_S = 6.0  # of which at most so much is skipped
SEED = 1  # of the other recording
WRONG = 10.0  # deg: found elsewhere
COLUMNS = ('model', 'target', 'motion', 'found after, frames', 'live, deg', 'final, deg', 'result', 'CPU, s')


def model_of(target: str, store: Path) -> tuple[Model, Array]:
    """The model of a scan of the target, and T_target_model (4, 4)."""
    folder = store / Path(target).stem
    placed = folder / 'T_target_model.npy'
    if not placed.exists():
        simulation, scanner = Simulation(SimulationSettings(target=target, seconds=SCANNED_S)), Scanner()
        truth = {}
        for frame in simulation:
            truth[frame.stamp_ns] = frame.T_sensor_target
            scanner.process(DepthFrame(frame.stamp_ns, frame.depth, frame.camera))
        result = scanner.finish()
        write_results(folder, result, SCANNED_S)
        np.save(placed, align(truth, by_stamp(result.poses)))
    return read_known_model(folder), np.load(placed)


def measure(of: str, target: str, motion: str, store: Path) -> dict[str, Any]:
    """Look for a target's model in a recording of a target; a row of the table, by column."""
    row: dict[str, Any] = {'model': Path(of).stem, 'target': Path(target).stem, 'motion': motion}
    try:
        model, T_target_model = model_of(of, store)
    except ValueError as error:
        return row | {'result': f'there is no model: {error}'}
    equal, began = list(_equal_turns(model)), time.process_time()
    scanner, truth = Scanner(model=model), {}
    live: dict[int, Array] = {}
    found = None
    for n, frame in enumerate(_frames(target, motion)):
        truth[frame.stamp_ns] = compose(frame.T_sensor_target, T_target_model)
        step = scanner.process(DepthFrame(frame.stamp_ns, frame.depth, frame.camera))
        if step.generation is not None and step.generation.model is not None:
            found = found or n + 1
        if step.estimate is not None and step.estimate.tracked and step.estimate.accepted:
            live[frame.stamp_ns] = step.estimate.T_sensor_target
    result = scanner.finish()
    row |= {
        'found after, frames': str(found or ''),
        'result': result.reason or 'tracked',
        'CPU, s': f'{time.process_time() - began:.0f}',
    }
    if of == target:
        row |= {
            'live, deg': _errors(truth, live, equal),
            'final, deg': _errors(truth, by_stamp(result.poses), equal) if result.reason is None else '',
        }
    return row


def _frames(target: str, motion: str) -> Iterator[SimulatedFrame]:
    skipped = np.random.default_rng([SEED, *target.encode(), *motion.encode()]).uniform(0, LATEST_S)
    settings = SimulationSettings(target=target, motion=motion, seed=SEED, seconds=TRACKED_S + LATEST_S)
    for n, frame in enumerate(Simulation(settings)):
        if skipped <= n / settings.rate_hz < skipped + TRACKED_S:
            yield frame


def _equal_turns(model: Model) -> Iterator[Array]:
    """Motions (4, 4) after which the model looks the same."""
    yield np.eye(4)
    for order, turn, share in turns_onto_itself(model.points, model.normals, model.spacing):
        if share >= SHARE:
            for power in range(1, order):
                yield np.linalg.matrix_power(turn, power)


def _errors(truth: dict[int, Array], poses: dict[int, Array], equal: list[Array]) -> str:
    """Attitude errors, median and largest, deg."""
    errors = [
        min(rotation_angle((inverse(poses[s]) @ truth[s] @ turn)[:3, :3]) for turn in equal)
        for s in sorted(truth.keys() & poses.keys())
    ]
    if not errors:
        return ''
    middle, largest = np.degrees([np.median(errors), np.max(errors)])
    return f'{middle:.3f} / {largest:.2f}' + (' WRONG' if middle > WRONG else '')


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shapes = [
        name for name in TARGET_NAMES if name not in ('empty', 'cylinder')
    ]  # no turn of a cylinder shows
    parser.add_argument('targets', nargs='*', default=shapes, metavar='TARGET', help='names or mesh files')
    parser.add_argument('--motions', nargs='+', default=['spin', 'tumble'], choices=MOTION_NAMES)
    parser.add_argument('--store', type=Path, default=Path('out/known_models'), help='of models and rows')
    args = parser.parse_args()
    args.store.mkdir(parents=True, exist_ok=True)
    file = args.store / 'rows.json'
    rows: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.is_file() else {}
    following = dict(zip(args.targets, [*args.targets[1:], args.targets[0]], strict=True))
    cases = [
        (target, shown, motion)
        for target in args.targets
        for shown in dict.fromkeys((target, following[target]))
        for motion in args.motions
    ]
    for of, target, motion in tqdm(cases, desc='recordings', disable=None):
        key = f'{Path(of).stem} {Path(target).stem} {motion}'
        if key not in rows:
            rows[key] = measure(of, target, motion, args.store)
            write_atomically(file, json.dumps(rows, indent=1).encode())
    print('| ' + ' | '.join(COLUMNS) + ' |\n|' + '---|' * len(COLUMNS))
    for row in rows.values():
        print('| ' + ' | '.join(str(row.get(name, '')) for name in COLUMNS) + ' |')


if __name__ == '__main__':
    main()
