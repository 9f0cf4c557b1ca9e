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

"""Odd targets through the simulator and the whole scanner: cases for run_fuzz.py.

A case is a shape that somebody may scan and nobody planned for (wire frames, plates, springs, gears, a tether
between two boxes, meshes with flipped normals or far from their origin, of two million triangles), in a
motion, before a sensor. It has to end in a model that is right, or in a reason; never in an exception, and
in bounded time.
"""

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import trimesh

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.results import StampedPose
from debris_scanner.evaluation.metrics import evaluate
from debris_scanner.io.result_files import write_results
from debris_scanner.modelling.generation import Generation
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import Simulation, SimulationSettings, write_truth
from debris_scanner.sim.targets import Target

SENSORS = ('kinect1', 'd435', 'lidar')
MOTIONS = ('spin', 'tumble')
SECONDS = {'spin': 14.0, 'tumble': 20.0}  # a turn and some more
RATE_HZ, LIDAR_HZ = 30.0, 10.0  # as most send
KINECT_SIZE_M = 0.4  # its targets have sizes of their own
MOST_TIMES_FRAMES = 4.0  # the time of a scan, in multiples of its frames' own

Mesh = trimesh.Trimesh


def _tube(path: np.ndarray, radius: float) -> Mesh:
    """Capped cylinders along a polyline (n, 3)."""
    parts = [
        trimesh.creation.cylinder(radius, segment=np.stack([a, b]), sections=8) for a, b in pairwise(path)
    ]
    return trimesh.util.concatenate(parts)


def _wire_frame(rng: np.random.Generator) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    corners *= rng.uniform(0.4, 1.0, 3)
    edges = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count('1') == 1]
    radius = rng.uniform(0.01, 0.04)
    return trimesh.util.concatenate([_tube(corners[list(e)], radius) for e in edges])


def _plate(rng: np.random.Generator) -> Mesh:
    return trimesh.creation.box((1.0, rng.uniform(0.3, 1.0), rng.uniform(0.004, 0.02)))


def _rod(rng: np.random.Generator) -> Mesh:
    return trimesh.creation.box((1.0, 0.02 * rng.uniform(0.7, 1.5), 0.02))


def _torus(rng: np.random.Generator) -> Mesh:
    return trimesh.creation.torus(0.4, rng.uniform(0.04, 0.18))


def _spring(rng: np.random.Generator) -> Mesh:
    turns = rng.integers(3, 8)
    t = np.linspace(0, 2 * np.pi * turns, 24 * turns)
    return _tube(np.column_stack([0.2 * np.cos(t), 0.2 * np.sin(t), t / t[-1]]), rng.uniform(0.015, 0.05))


def _gear(rng: np.random.Generator) -> Mesh:
    teeth = int(rng.integers(6, 18))
    angle = np.linspace(0, 2 * np.pi, 4 * teeth, endpoint=False)
    radius = np.where(np.arange(4 * teeth) % 4 < 2, 0.5, 0.4)
    outline = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    outline = np.concatenate([[[0.0, 0.0]], outline])  # star-shaped about its centre
    fan = np.array([[0, k + 1, (k + 1) % (4 * teeth) + 1] for k in range(4 * teeth)])
    return trimesh.creation.extrude_triangulation(outline, fan, rng.uniform(0.05, 0.3))


def _screw(rng: np.random.Generator) -> Mesh:
    t = np.linspace(0, 16 * np.pi, 200)
    thread = _tube(np.column_stack([0.1 * np.cos(t), 0.1 * np.sin(t), 0.8 * t / t[-1]]), 0.02)
    shaft = trimesh.creation.cylinder(0.1, 0.8).apply_translation((0, 0, 0.4))
    head = trimesh.creation.cylinder(0.2, 0.1, sections=int(rng.integers(4, 9))).apply_translation(
        (0, 0, 0.85)
    )
    return trimesh.util.concatenate([thread, shaft, head])


def _shell(rng: np.random.Generator) -> Mesh:
    ball = trimesh.creation.icosphere(4, 0.5)
    kept = ball.triangles_center[:, 2] > rng.uniform(-0.3, 0.2)
    return Mesh(ball.vertices, np.concatenate([ball.faces[kept], ball.faces[kept][:, ::-1]]), process=False)


def _tethered(rng: np.random.Generator) -> Mesh:
    a = trimesh.creation.box(rng.uniform(0.15, 0.3, 3)).apply_translation((-0.4, 0, 0))
    b = trimesh.creation.box(rng.uniform(0.1, 0.3, 3)).apply_translation((0.4, 0.05, 0))
    tether = _tube(np.array([[-0.4, 0, 0], [0.4, 0.05, 0]]), rng.uniform(0.002, 0.015))
    return trimesh.util.concatenate([a, b, tether])


def _bump(rng: np.random.Generator) -> Mesh:
    ball = trimesh.creation.icosphere(4, 0.5)
    size = rng.uniform(0.03, 0.2)
    return trimesh.util.concatenate(
        [ball, trimesh.creation.icosphere(3, size).apply_translation((0.5, 0, 0.05))]
    )


def _open_box(rng: np.random.Generator) -> Mesh:
    w, d, h = rng.uniform(0.4, 1.0, 3)
    wall = rng.uniform(0.01, 0.04)
    sides = [
        ((w, d, wall), (0, 0, 0)),
        ((wall, d, h), (-w / 2, 0, h / 2)),
        ((wall, d, h), (w / 2, 0, h / 2)),
        ((w, wall, h), (0, -d / 2, h / 2)),
        ((w, wall, h), (0, d / 2, h / 2)),
    ]
    return trimesh.util.concatenate([trimesh.creation.box(s).apply_translation(at) for s, at in sides])


def _cube(rng: np.random.Generator) -> Mesh:
    return trimesh.creation.box((1, 1, 1))


def _dense(rng: np.random.Generator) -> Mesh:
    ball = trimesh.creation.icosphere(8 if rng.random() < 0.1 else 6)  # 1.3 million, or 80 000
    wave = 1 + 0.2 * np.sin(5 * ball.vertices).sum(axis=1)
    return Mesh(ball.vertices * wave[:, None], ball.faces, process=False)


def _flipped(rng: np.random.Generator) -> Mesh:
    mesh = trimesh.util.concatenate([_bump(rng), _plate(rng)])
    chosen = rng.random(len(mesh.faces)) < 0.5
    return Mesh(mesh.vertices, np.where(chosen[:, None], mesh.faces[:, ::-1], mesh.faces), process=False)


def _off_centre(rng: np.random.Generator) -> Mesh:
    return _open_box(rng).apply_translation(rng.uniform(-0.4, 0.4, 3))


SHAPES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    'wire_frame': _wire_frame,
    'plate': _plate,
    'rod': _rod,
    'torus': _torus,
    'spring': _spring,
    'gear': _gear,
    'screw': _screw,
    'shell': _shell,
    'tethered': _tethered,
    'bump': _bump,
    'open_box': _open_box,
    'cube': _cube,
    'dense': _dense,
    'flipped': _flipped,
    'off_centre': _off_centre,
}
KINDS = tuple(SHAPES)


@dataclass(frozen=True)
class Outcome:
    """What came of a case; times in seconds of this process's CPU."""

    kind: str
    motion: str
    sensor: str
    reason: str | None
    why: str
    verdict: str  # of evaluate: a model is right or wrong; without one, whether there could have been any
    attitude_deg: dict[str, float] | None
    errors: dict[str, int]
    frames: int
    frames_s: float
    attempts_s: float
    attempts: int
    timing: dict[str, float]

    @property
    def times_frames(self) -> float:
        """The whole scan's time, in multiples of its frames' own."""
        return (self.frames_s + self.attempts_s) / self.frames_s


def run_case(kind: str, random: Random) -> str:
    """Run one case; its outcome as JSON.

    Raises:
        AssertionError: an exception was met on the way, the model is wrong, or it took too long.
    """
    outcome = scan(kind, random)
    text = json.dumps(vars(outcome), default=float)
    assert not outcome.errors, text
    assert outcome.reason is not None or outcome.verdict == 'right', text
    assert outcome.times_frames <= MOST_TIMES_FRAMES, text
    return text


def scan(kind: str, random: Random) -> Outcome:
    """Simulate, scan and judge one case."""
    rng = np.random.default_rng(random.getrandbits(63))
    mesh = SHAPES[kind](rng)
    sensor, motion = random.choice(SENSORS), random.choice(MOTIONS)
    size = (find_sensor(sensor).size_m or KINECT_SIZE_M) * rng.uniform(0.6, 1.2)
    vertices = mesh.vertices * (size / np.ptp(mesh.vertices, axis=0).max())
    if kind != 'off_centre':
        vertices = vertices - vertices.mean(axis=0)
    target = Target(kind, vertices.astype(np.float32), np.asarray(mesh.faces, np.int32))
    settings = SimulationSettings(
        motion=motion,
        seed=random.randrange(10**6),
        rate_hz=LIDAR_HZ if sensor == 'lidar' else RATE_HZ,
        seconds=SECONDS[motion],
        sensor=sensor,
        spin_rad_s=random.choice((-1, 1)) * rng.uniform(0.5, 0.8),
    )
    scanner, attempts = Scanner(Settings()), list[float]()
    builder = scanner.back_end.builder
    generate = builder.generate

    def timed(*args: Any) -> Generation:
        begun_s = time.process_time()
        try:
            return generate(*args)
        finally:
            attempts.append(time.process_time() - begun_s)

    builder.generate = timed  # type: ignore[method-assign]
    frames, poses, frames_s = list[DepthFrame](), list[StampedPose](), 0.0
    for simulated in Simulation(settings, target):
        frame = DepthFrame(simulated.stamp_ns, simulated.depth, simulated.camera)
        frames.append(frame)
        poses.append(StampedPose(frame.stamp_ns, simulated.T_sensor_target))
        begun_s, before_s = time.process_time(), sum(attempts)
        scanner.process(frame)
        frames_s += time.process_time() - begun_s - (sum(attempts) - before_s)
    result = scanner.finish()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_results(folder, result, 0.0)
        write_truth(folder, [p.stamp_ns for p in poses], [p.T_sensor_target for p in poses], target)
        metrics = evaluate(folder, folder, frames)
    last = builder.last
    timing = {k: row['count'] * row['p50_ms'] / 1e3 for k, row in scanner.timer.summary().items()}
    return Outcome(
        kind, motion, sensor, result.reason, last.why if last is not None else '', metrics['verdict'],
        metrics['attitude_deg'], result.errors, len(frames), frames_s, sum(attempts), len(attempts), timing,
    )  # fmt: skip
