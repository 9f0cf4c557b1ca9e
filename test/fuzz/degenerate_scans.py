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

"""Degenerate geometry through the whole scanner: cases for run_fuzz.py.

A case is a short recording of what no target looks like: flat, a pixel wide, tiny, huge, empty, one frame,
all pixels equal, a million metres away; with or without a known model; or two such models to merge. What
must not happen is any exception.
"""

from random import Random

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, Model
from debris_scanner.merging import merge
from debris_scanner.modelling.placement import MatchSettings
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.tracking.gating import STRICT

SCENES = ('flat', 'thin', 'tiny', 'huge', 'empty', 'equal', 'far', 'steps', 'specks', 'bumps')
SHAPES = ('none', 'one', 'line', 'plane', 'box', 'huge', 'far')
KINDS = ('scan',) * 39 + ('known',) * 10 + ('merge',)  # a merge takes half a minute
SETTINGS = Settings()


def picture(scene: str, rng: np.random.Generator, h: int, w: int, k: int) -> np.ndarray:
    """Depth (h, w), m, of frame k of a scene."""
    v, u = np.mgrid[:h, :w].astype(np.float32)
    depth = np.zeros((h, w), np.float32)
    at = rng.uniform(0.2, 6.0)
    if scene == 'flat':
        depth[h // 4 : 3 * h // 4, w // 4 : 3 * w // 4] = at
    elif scene == 'thin':
        (depth if rng.random() < 0.5 else depth.T)[:, (w // 2 + k) % min(h, w)] = at
    elif scene == 'tiny':
        depth[h // 2, w // 2 : w // 2 + rng.integers(1, 4)] = at
    elif scene == 'huge':
        depth[:] = 15.0 + 4.0 * np.sin(u / 5 + k)
    elif scene == 'equal':
        depth[:] = at
    elif scene == 'far':
        depth[:] = rng.choice([1e6, 3.0e38, 1e-30, 1e-6], (h, w)).astype(np.float32)
        depth[:, : w // 2] = at
    elif scene == 'steps':
        depth[:] = at + 0.05 * ((u + k) // 3 % 2)
    elif scene == 'specks':
        depth[rng.random((h, w)) < 0.05] = at
    elif scene == 'bumps':
        disc = (u - w / 2 - k) ** 2 + (v - h / 2) ** 2 < (min(h, w) / 2.6) ** 2
        depth = np.where(disc, at + 0.01 * np.sin(u / 3), 0).astype(np.float32)
    return depth


def shape(name: str, rng: np.random.Generator) -> Model:
    """A model to look for or to merge; of every one but the box something is wrong."""
    points = {
        'none': np.zeros((0, 3)),
        'one': np.zeros((1, 3)),
        'line': np.linspace(0, 0.3, 60)[:, None] * [1, 0, 0],
        'plane': np.stack(
            [*np.meshgrid(np.linspace(0, 0.3, 15), np.linspace(0, 0.3, 15)), np.zeros((15, 15))], -1
        ),
    }.get(name)
    if points is None:
        points = rng.uniform(-0.2, 0.2, (300, 3))
        points[np.arange(300), rng.integers(0, 3, 300)] = rng.choice([-0.2, 0.2], 300)
        points *= {'huge': 1e3, 'far': 1.0, 'box': 1.0}[name]
        points += 1e6 if name == 'far' else 0
    points = points.reshape(-1, 3).astype(np.float32)
    normals = np.tile(np.float32([0, 0, 1]), (len(points), 1))
    count = max(0, len(points) - 2)
    triangles = np.stack([np.arange(count), np.arange(count) + 1, np.arange(count) + 2], 1).astype(np.int32)
    return Model(points, normals, points, triangles)


def run_case(kind: str, random: Random) -> str:
    """Run one case; what it was. It has to end in a verdict, whatever is wrong with it."""
    rng = np.random.default_rng(random.getrandbits(63))
    if kind == 'merge':
        names = [random.choice(SHAPES) for _ in range(2)]
        bounds = MatchSettings(STRICT * SETTINGS.odometry.max_loss, SETTINGS.verdict.min_turning_loss)
        merged = merge([shape(name, rng) for name in names], SETTINGS.fusion, bounds)
        assert merged.model is not None or merged.reason
        return 'merge ' + ' '.join(names)
    scene, (h, w) = random.choice(SCENES), random.choice(((1, 1), (1, 160), (120, 1), (48, 64), (60, 80)))
    focal = random.choice((1.0, 80.0, 500.0, 4000.0))
    camera = Camera(focal, focal, (w - 1) / 2, (h - 1) / 2, w, h)
    known = random.choice(SHAPES) if kind == 'known' else None
    scanner = Scanner(SETTINGS, model=None if known is None else shape(known, rng))
    stamp_ns = 1_000_000_000
    for k in range(random.choice((0, 1, 1, 2, 4, 8))):
        moves = 0 if random.random() < 0.3 else k
        scanner.process(DepthFrame(stamp_ns, picture(scene, rng, h, w, moves), camera))
        stamp_ns += random.choice((0, 1, 33_000_000, 100_000_000, 10**10))
    result = scanner.finish()
    assert result.model is not None or result.reason
    return f'{kind} {scene}'
