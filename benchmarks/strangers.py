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

"""Targets and sensors that nobody has tuned anything to: drawn by a number.

Shapes that were looked at often are held out no more. These are looked at once, at the end of a piece of
work, and a failure gives no rule. Then other numbers are taken.
"""

import dataclasses
from typing import Any

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import exp_so3
from debris_scanner.sim.rays import PinholeRays
from debris_scanner.sim.sensors import KINECT1, SENSORS, SensorModel
from debris_scanner.sim.shapes import Solid, box, bumpy_sphere, dome, join, lathe, place, rod

STRANGERS = range(48, 72)
_OWN_SIZE_M = 0.35  # of a target before a sensor that suits any
_RATES_HZ = (5.0, 10.0, 15.0)
_ERRORS = ('oblique_px', 'correlation_px', 'jagged_px', 'bump_px', 'offset_share', 'flying', 'edge_dropout')
_MOTIONS = ('spin', 'tumble', 'gaps', 'swing')


def craft(number: int) -> Solid:
    """Mesh of a target, any unit: a rock, or a body with what spacecraft carry."""
    rng = np.random.default_rng([number, 21])
    if number % 4 == 0:
        return _rock(rng)
    return join([*(_round_body(rng) if number % 4 == 1 else _boxes(rng)), *_outfit(rng)])


def sensor(number: int) -> SensorModel:
    """One of the simulated sensors, each of its errors and its focal length somewhat larger or smaller."""
    rng = np.random.default_rng([number, 22])
    names = [name for name in SENSORS if name != KINECT1]
    model = SENSORS[names[int(rng.integers(len(names)))]]

    def varied(value: float) -> float:
        return float(value * np.exp(rng.uniform(-0.4, 0.4)))

    changes: dict[str, Any] = {name: varied(getattr(model, name)) for name in _ERRORS}
    changes['axial'] = tuple(varied(c) for c in model.axial)
    if isinstance(model.rays, PinholeRays):
        c = model.rays.camera
        focal = c.fx * float(rng.uniform(0.85, 1.1))
        changes['rays'] = PinholeRays(Camera(focal, focal, c.cx, c.cy, c.width, c.height))
    return dataclasses.replace(model, **changes)


def recording(number: int) -> tuple[str, dict[str, Any]]:
    """Motion, and the options of the simulator beside those of the motion."""
    rng = np.random.default_rng([number, 23])
    model = sensor(number)
    motion = _MOTIONS[int(rng.integers(len(_MOTIONS)))]
    rate = float(rng.uniform(0.3, 0.8)) * float(rng.choice([-1.0, 1.0]))
    seconds = 45.0 if motion in ('tumble', 'gaps') else round(1.6 * 2 * np.pi / abs(rate), 1)
    return motion, {
        'sensor': model.name,
        'spin_rad_s': round(rate, 3),
        'seconds': seconds,
        'rate_hz': float(rng.choice(_RATES_HZ)),
        'size': round(float((model.size_m or _OWN_SIZE_M) * rng.uniform(0.75, 1.15)), 3),
        'range_m': round(float(model.range_m * rng.uniform(0.95, 1.25)), 2),
    }


def _rock(rng: np.random.Generator) -> Solid:
    vertices, triangles = bumpy_sphere(rng, 40, (0.15, 0.6))
    return vertices * rng.uniform(0.6, 1.0, 3), triangles


def _round_body(rng: np.random.Generator) -> list[Solid]:
    radius, half = rng.uniform(0.35, 0.6), rng.uniform(0.6, 1.0)
    ends = [
        *reversed(dome(radius, -rng.uniform(0.1, 0.3), -half)),
        *dome(radius, rng.uniform(0.1, 0.3), half),
    ]
    throat, exit_ = rng.uniform(0.1, 0.15), rng.uniform(0.2, 0.35)
    bell = lathe(
        [(0.0, -half), (throat, -half - 0.1), (exit_, -half - rng.uniform(0.3, 0.6)), (0.0, -half - 0.3)]
    )
    return [lathe(ends), bell]


def _boxes(rng: np.random.Generator) -> list[Solid]:
    size = rng.uniform(0.6, 1.4, 3)
    on_top = rng.uniform(0.2, 0.5, 3)
    where = [*(0.5 * (size - on_top)[:2] * rng.uniform(-1, 1, 2)), 0.5 * (size + on_top)[2]]
    return [box(size.tolist()), box(on_top.tolist(), where)]


def _outfit(rng: np.random.Generator) -> list[Solid]:
    """One or two panels, a dish, a boom with its box, and two boxes on the flank."""
    parts = []
    for side in rng.permutation([-1.0, 1.0])[: int(rng.integers(1, 3))]:
        panel = box((rng.uniform(0.7, 1.6), 0.05, rng.uniform(0.4, 0.8)), (1.4, 0.0, 0.0))
        R = exp_so3(np.array([rng.uniform(-0.6, 0.6), 0.0, 0.0 if side > 0 else np.pi]))
        at = (0.0, 0.0, rng.uniform(-0.3, 0.3))
        parts += [place(panel, at, R if side > 0 else R @ np.diag([-1.0, 1.0, -1.0]))]
        parts += [rod((0.0, 0.0, at[2]), (side * 1.0, 0.0, at[2]), 0.05)]
    rim, depth = rng.uniform(0.3, 0.5), rng.uniform(0.1, 0.25)
    bowl = [(0.04, 0.0), (0.5 * rim, 0.3 * depth), (rim, depth)]
    dish = lathe([*bowl, *((r - 0.015, z + 0.03) for r, z in reversed(bowl[1:])), (0.0, 0.03)], 48)
    parts += [
        place(dish, (0.0, rng.uniform(0.6, 0.8), 0.2), exp_so3(np.array([-rng.uniform(0.8, 1.9), 0.3, 0.0])))
    ]
    parts += [rod((0.0, 0.0, 0.2), (0.0, 0.75, 0.2), 0.07)]
    tip = [rng.uniform(-0.6, 0.6), -rng.uniform(0.9, 1.5), rng.uniform(-0.8, 0.8)]
    parts += [rod((0.0, -0.2, 0.0), tip, 0.05), box(rng.uniform(0.15, 0.3, 3).tolist(), tip)]
    for x in (-1.0, 1.0):
        parts += [
            box(rng.uniform(0.2, 0.5, 3).tolist(), (0.5 * x, rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5)))
        ]
    return parts
