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

"""``python -m benchmarks.adversaries``: scans that have no right model, or hardly one.

Targets that change while they are watched, that are pushed while out of sight, that look the same from
several sides and hide, that a turn does not show of; and known models that are not the target's. Of the
first, and of the last, any model is a wrong one; of the others, one that ``evaluate`` calls so.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from tqdm import tqdm

from benchmarks.closure_pairs import shape
from benchmarks.scorecard.tables import markdown
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.results import StampedPose
from debris_scanner.evaluation.metrics import evaluate
from debris_scanner.io.known_models import read_known_model
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.io.result_files import write_results
from debris_scanner.scanner import Scanner
from debris_scanner.sim.gaps import Gaps
from debris_scanner.sim.motions import SPIN, TUMBLE
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import SimulatedFrame, Simulation, SimulationSettings, write_truth
from debris_scanner.sim.targets import Target, make_target

SIZE_M = 0.34  # of targets seen by a sensor whose record names none
SENSORS = ('kinect1', 'd435', 'azure', 'kinect2')
SHAPES = ('shuttle_stack', 'defunct_satellite', 'asteroid')
SECONDS, STEPS = 25.0, 24  # of a recording, in which a slow change has so many steps
HIDDEN_S = (5.0, 15.0)
SEED = 38

Corners = np.ndarray[Any, np.dtype[np.float64]]


def bent(v: Corners, share: float) -> Corners:
    """Up to 4.4 % of the size aside at one end."""
    along = (v[:, 2] - v[:, 2].min()) / np.ptp(v[:, 2])
    return v + share * 0.044 * np.ptp(v, axis=0).max() * np.outer(along**2, [1.0, 0.0, 0.0])


def twisted(v: Corners, share: float) -> Corners:
    """Up to 20 degrees from end to end."""
    angle = share * np.radians(20.0) * (v[:, 2] - v[:, 2].min()) / np.ptp(v[:, 2])
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]])


def breathing(v: Corners, share: float) -> Corners:
    """4 % larger and smaller, two and a half times."""
    return v * (1 + 0.04 * np.sin(5 * np.pi * share))


def growing(v: Corners, share: float) -> Corners:
    """By 3 %."""
    return v * (1 + 0.03 * share)


def stretched(v: Corners, share: float) -> Corners:
    """By 3 % along one axis."""
    return v * [1.0, 1.0, 1 + 0.03 * share]


CHANGES: dict[str, Callable[[Corners, float], Corners]] = {
    'bent at half time': bent,
    'twisted slowly': twisted,
    'breathing': breathing,
    'growing': growing,
}
KNOB, PUSHED, HIDING, BOWL, SPRING = 'a knob at half time', 'pushed', 'faces alike, hidden', 'bowl', 'spring'
MODELS = {'bent': bent, 'stretched': stretched, 'larger by 3 %': growing, 'with a knob': None}


@dataclass(frozen=True)
class Case:
    """One scan: what is wrong with it, the target, the sensor."""

    what: str
    target: str
    sensor: str
    motion: str = SPIN
    hidden_s: float = 0.0
    model: bool = False  # the known model is wrong, not the target


def all_cases() -> list[Case]:
    """The sensors take turns."""
    changes = [Case(c, t, '') for c, t in product((*CHANGES, KNOB), SHAPES)]
    changes += [replace(c, motion=TUMBLE) for c in changes if c.target == 'shuttle_stack']
    pushed = [Case(PUSHED, t, '', hidden_s=s) for t, s in product(('prism', 'cubesat', *SHAPES), HIDDEN_S)]
    alike = [Case(HIDING, t, '', hidden_s=s) for t, s in product(('hexagon', 'octagon', 'box'), HIDDEN_S)]
    odd = [Case(w, w, '', m) for w, m, _ in product((BOWL, SPRING), (SPIN, TUMBLE), range(2))]
    models = [Case(m, t, '', model=True) for m, t in product(MODELS, (*SHAPES, 'cubesat'))]
    cases = [*changes, *pushed, *alike, *odd, *models]
    return [replace(c, sensor=SENSORS[k % len(SENSORS)]) for k, c in enumerate(cases)]


def target_of(case: Case, size: float) -> Target:
    """The rigid target."""
    if case.what == HIDING:
        return shape(case.target, size)
    if case.what == BOWL:
        ball = trimesh.creation.icosphere(4, 0.5)
        kept = ball.faces[ball.triangles_center[:, 2] > 0]
        mesh = trimesh.Trimesh(ball.vertices, np.concatenate([kept, kept[:, ::-1]]), process=False)
    elif case.what == SPRING:
        t = np.linspace(0, 10 * np.pi, 120)
        path = np.column_stack([0.2 * np.cos(t), 0.2 * np.sin(t), t / t[-1]])
        rods = [trimesh.creation.cylinder(0.03, segment=path[k : k + 2], sections=8) for k in range(119)]
        mesh = trimesh.Trimesh(
            np.concatenate([rod.vertices for rod in rods]),
            np.concatenate([rod.faces + k * len(rods[0].vertices) for k, rod in enumerate(rods)]),
            process=False,
        )
    else:
        return make_target(case.target, size)
    vertices = mesh.vertices - mesh.vertices.mean(axis=0)
    vertices *= size / np.ptp(vertices, axis=0).max()
    return Target(case.what, vertices.astype(np.float32), np.asarray(mesh.faces, np.int32))


def with_knob(target: Target, size: float) -> Target:
    """A cube of 7.4 % of the size on its flank."""
    vertices = target.vertices.astype(np.float64)
    middle = vertices[np.abs(vertices[:, 2]) < 0.15 * size]
    knob = trimesh.creation.box(np.full(3, 0.074 * size))
    corners = np.concatenate([vertices, knob.vertices + middle[np.argmax(middle[:, 0])]])
    triangles = np.concatenate([target.triangles, knob.faces + len(vertices)])
    return replace(target, vertices=corners.astype(np.float32), triangles=triangles.astype(np.int32))


def changed(target: Target, change: Callable[[Corners, float], Corners], share: float) -> Target:
    """The target after a share of its change."""
    return replace(target, vertices=change(target.vertices.astype(np.float64), share).astype(np.float32))


def frames_of(
    case: Case, target: Target, settings: SimulationSettings, size: float
) -> Iterator[SimulatedFrame]:
    """The recording."""
    first = later = Simulation(settings, target)
    count, at = len(first), 0
    if case.hidden_s:
        gaps = Gaps(((SECONDS / 3, SECONDS / 3 + case.hidden_s),))
        first.motion = replace(first.motion, gaps=gaps)  # type: ignore[type-var]
    if case.what == PUSHED:  # out of sight it has turned half as far again
        later, attitude = Simulation(settings, target), first.motion.attitude  # type: ignore[attr-defined]
        later.motion = replace(  # type: ignore[type-var]
            first.motion, attitude=lambda t: attitude(t + case.hidden_s / 2)
        )
    for k in range(count):
        share = k / (count - 1)
        if case.what == PUSHED:
            yield (later if share * SECONDS > SECONDS / 3 + case.hidden_s / 2 else first).frame(k)
        elif case.model or case.what not in (*CHANGES, KNOB):
            yield first.frame(k)
        elif case.what == KNOB or case.what.endswith('half time'):
            if share >= 0.5 and later is first:
                second = with_knob(target, size) if case.what == KNOB else changed(target, bent, 1.0)
                later = Simulation(settings, second)
            yield later.frame(k)
        else:
            step = int(share * STEPS)
            if step != at:
                at, later = step, Simulation(settings, changed(target, CHANGES[case.what], step / STEPS))
            yield later.frame(k)


def run(case: Case) -> dict[str, Any]:
    """Scan a case; what came of it."""
    size = find_sensor(case.sensor).size_m or SIZE_M
    target = target_of(case, size)
    seed = SEED + all_cases().index(case)
    settings = SimulationSettings(motion=case.motion, sensor=case.sensor, seconds=SECONDS, seed=seed)
    with tempfile.TemporaryDirectory() as name:
        folder, model = Path(name), None
        if case.model:
            change = MODELS[case.what]
            other = with_knob(target, size) if change is None else changed(target, change, 1.0)
            write_mesh_ply(folder / 'model_given.ply', other.vertices, other.triangles)
            model = read_known_model(folder / 'model_given.ply')
        scanner, poses, frames = Scanner(model=model), list[StampedPose](), list[DepthFrame]()
        for seen in frames_of(case, target, settings, size):
            frames.append(DepthFrame(seen.stamp_ns, seen.depth, seen.camera))
            poses.append(StampedPose(seen.stamp_ns, seen.T_sensor_target))
            scanner.process(frames[-1])
        result = scanner.finish()
        write_results(folder, result, 0.0)
        write_truth(folder, [p.stamp_ns for p in poses], [p.T_sensor_target for p in poses], target)
        metrics = evaluate(folder, folder, frames)
    published, verdict = result.reason is None, metrics['verdict']
    wrong = published and (case.model or verdict != 'right')
    return {
        **vars(case), 'reason': result.reason, 'verdict': verdict, 'wrong': wrong,
        'attitude_deg': metrics['attitude_deg'], 'model_mm': metrics['model_mm'], 'errors': result.errors,
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each kind."""
    kinds = list(dict.fromkeys((r['model'], r['what']) for r in rows))
    lines = []
    for kind in kinds:
        of = [r for r in rows if (r['model'], r['what']) == kind]
        reasons = ', '.join(sorted({r['reason'] for r in of if r['reason']}))
        right = sum(r['reason'] is None and not r['wrong'] for r in of)
        refused, wrong = sum(r['reason'] is not None for r in of), sum(r['wrong'] for r in of)
        name = f'known model: {kind[1]}' if kind[0] else kind[1]
        lines.append([name, str(len(of)), str(right), str(refused), str(wrong), reasons])
    return markdown(['what', 'scans', 'right', 'refused', 'wrong', 'reasons'], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument(
        '--out', type=Path, default=Path('out/adversaries.jsonl'), help='rows, kept (%(default)s)'
    )
    parser.add_argument('--jobs', type=int, default=2, help='at a time (%(default)s)')
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    keys = tuple(vars(all_cases()[0]))
    done = {tuple(row[k] for k in keys) for row in rows}
    todo = [case for case in all_cases() if tuple(vars(case).values()) not in done]
    with ProcessPoolExecutor(given.jobs) as pool, given.out.open('a') as kept:
        for row in tqdm(pool.map(run, todo), total=len(todo)):
            rows.append(row)
            kept.write(json.dumps(row, default=float) + '\n')
            kept.flush()
    print(table(rows))


if __name__ == '__main__':
    main()
