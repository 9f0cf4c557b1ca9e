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

Targets that change while they are watched; that are pushed, or show another of several equal faces, while
they are out of sight; bowls and springs, whose turn hardly shows; and known models that are not quite the
target's. A known model that is tracked is wrong, and so is a model that ``evaluate`` calls wrong.
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
from debris_scanner.core.geometry import Array
from debris_scanner.core.results import StampedPose
from debris_scanner.evaluation.metrics import evaluate
from debris_scanner.io.known_models import read_known_model
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.io.result_files import write_results
from debris_scanner.scanner import Scanner
from debris_scanner.sim.gaps import Gaps
from debris_scanner.sim.motions import SPIN, TUMBLE, Motion
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import SimulatedFrame, Simulation, SimulationSettings, write_truth
from debris_scanner.sim.targets import Target, make_target

SIZE_M = 0.34  # of targets seen by a sensor whose record names none
SENSORS = ('kinect1', 'd435', 'azure', 'kinect2')
SHAPES = ('shuttle_stack', 'defunct_satellite', 'asteroid')
SECONDS, STEPS = 25.0, 24  # of a recording, in which a slow change has so many steps
HIDDEN_S = (5.0, 15.0)
SEED = 38


def bent(target: Target, share: float = 1.0) -> Target:
    """A share of 4.4 % of the size aside at one end."""
    v, along = _corners(target), _along(target)
    return _moved(target, v + share * 0.044 * _size(target) * np.outer(along**2, [1.0, 0.0, 0.0]))


def twisted(target: Target, share: float = 1.0) -> Target:
    """A share of 20 degrees from end to end."""
    v, angle = _corners(target), share * np.radians(20.0) * _along(target)
    c, s = np.cos(angle), np.sin(angle)
    return _moved(target, np.column_stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]]))


def breathing(target: Target, share: float = 1.0) -> Target:
    """4 % larger and smaller, two and a half times until the share is one."""
    return _moved(target, _corners(target) * (1 + 0.04 * np.sin(5 * np.pi * share)))


def growing(target: Target, share: float = 1.0) -> Target:
    """A share of 3 % larger."""
    return _moved(target, _corners(target) * (1 + 0.03 * share))


def stretched(target: Target, share: float = 1.0) -> Target:
    """A share of 3 % longer along one axis."""
    return _moved(target, _corners(target) * [1.0, 1.0, 1 + 0.03 * share])


def with_knob(target: Target, share: float = 1.0) -> Target:
    """With a cube on its flank, whose side is a share of 7.4 % of the size."""
    if not share:
        return target
    v, size = _corners(target), _size(target)
    middle = v[np.abs(v[:, 2]) < 0.15 * size]
    knob = trimesh.creation.box(np.full(3, 0.074 * share * size))
    triangles = np.concatenate([target.triangles, knob.faces + len(v)]).astype(np.int32)
    corners = np.concatenate([v, knob.vertices + middle[np.argmax(middle[:, 0])]])
    return _moved(replace(target, triangles=triangles), corners)


def _corners(target: Target) -> Array:
    return target.vertices.astype(np.float64)


def _size(target: Target) -> float:
    return float(np.ptp(target.vertices, axis=0).max())


def _along(target: Target) -> Array:
    """How far along its z axis each corner (n,) is, from 0 to 1."""
    z = _corners(target)[:, 2]
    return np.asarray((z - z.min()) / np.ptp(z))


def _moved(target: Target, corners: Array) -> Target:
    return replace(target, vertices=corners.astype(np.float32))


Change = Callable[[Target, float], Target]  # the target, and how much of the change
AT_ONCE: dict[str, Change] = {'bent at half time': bent, 'a knob at half time': with_knob}
SLOWLY: dict[str, Change] = {'twisted slowly': twisted, 'breathing': breathing, 'growing': growing}
CHANGES = AT_ONCE | SLOWLY
PUSHED, HIDING, BOWL, SPRING = 'pushed', 'faces alike, hidden', 'bowl', 'spring'
MODELS: dict[str, Change] = {
    'bent': bent,
    'stretched': stretched,
    'larger by 3 %': growing,
    'with a knob': with_knob,
}


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
    changes = [Case(c, t, '') for c, t in product(CHANGES, SHAPES)]
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


@dataclass(frozen=True)
class Hidden:
    """A motion that nobody sees for a while; in the middle of that the target may be pushed on."""

    motion: Motion
    gaps: Gaps
    pushed_s: float = 0.0  # by what it turns in so long

    def T_sensor_target(self, t_s: float) -> Array:
        (from_s, to_s), *_ = self.gaps.intervals
        return self.motion.T_sensor_target(t_s + (self.pushed_s if t_s > (from_s + to_s) / 2 else 0.0))

    def T_sensor_world(self, t_s: float) -> Array:
        return self.motion.T_sensor_world(t_s)

    def visibility(self, t_s: float) -> float:
        return self.gaps.visibility(t_s)

    def hand_away(self, t_s: float) -> float:
        return self.motion.hand_away(t_s)


def frames_of(case: Case, target: Target, settings: SimulationSettings) -> Iterator[SimulatedFrame]:
    """The recording."""
    seen, before = Simulation(settings, target), 0.0
    if case.hidden_s:
        gaps = Gaps(((SECONDS / 3, SECONDS / 3 + case.hidden_s),))
        seen.motion = Hidden(seen.motion, gaps, case.hidden_s / 2 if case.what == PUSHED else 0.0)
    for k in range(len(seen)):
        steps = {**dict.fromkeys(AT_ONCE, 2), **dict.fromkeys(SLOWLY, STEPS)}.get(case.what, 1)
        share = int(k / len(seen) * steps) / max(1, steps - 1)
        if share != before:
            before, seen = share, Simulation(settings, CHANGES[case.what](target, share))
        yield seen.frame(k)


def run(case: Case) -> dict[str, Any]:
    """Scan a case; what came of it."""
    size = find_sensor(case.sensor).size_m or SIZE_M
    target = target_of(case, size)
    seed = SEED + all_cases().index(case)
    settings = SimulationSettings(motion=case.motion, sensor=case.sensor, seconds=SECONDS, seed=seed)
    with tempfile.TemporaryDirectory() as name:
        folder, model = Path(name), None
        if case.model:
            other = MODELS[case.what](target, 1.0)
            write_mesh_ply(folder / 'model_given.ply', other.vertices, other.triangles)
            model = read_known_model(folder / 'model_given.ply')
        scanner, poses, frames = Scanner(model=model), list[StampedPose](), list[DepthFrame]()
        for seen in frames_of(case, target, settings):
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
