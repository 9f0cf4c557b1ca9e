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

"""PCL on the same clouds, through the program in ``pcl/``; left out with a word where it cannot be built."""

import itertools
import json
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.performance.measure import Cost, Row
from benchmarks.performance.ours import summary
from benchmarks.performance.scene import Shot, drifted, pair_error, pose_errors
from debris_scanner.core.geometry import Array, apply, inverse

SOURCES = Path(__file__).parent / 'pcl'
WHO = 'PCL'
LUM_OUTER = 40


class PclMissing(Exception):
    """PCL or what builds against it is not here."""


class PclPeer:
    """The built program and the clouds it reads.

    Args:
        folder: for the build and the clouds.

    Raises:
        PclMissing: why there will be no figures of PCL.
    """

    def __init__(self, folder: Path) -> None:
        build = folder / 'build'
        self._data = folder / 'clouds'
        self._data.mkdir(parents=True, exist_ok=True)
        if not shutil.which('cmake') or not (shutil.which('c++') or shutil.which('g++')):
            raise PclMissing('no cmake and C++ compiler: apt-get install cmake g++ libpcl-dev')
        for command in (['cmake', '-S', str(SOURCES), '-B', str(build)], ['cmake', '--build', str(build)]):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                lines = [line for line in (done.stderr + done.stdout).splitlines() if 'rror' in line]
                said = ' '.join(lines[:1]) or 'no word why'
                raise PclMissing(f'the peer program does not build (apt-get install libpcl-dev): {said}')
        self._program = build / 'pcl_peers'

    def stages(self, shot: Shot, merged: Sequence[Shot], times: int) -> list[Row]:
        """Voxel grid, normals, VFH of a frame; outliers, MLS and greedy projection of merged frames."""
        self._write('frame', shot.organised)
        self._write('merged', merged_cloud(merged))
        names = {'outliers': '3 sigma, k = 50', 'moving least squares': 'order 5, 5 mm'}
        return [
            Row(r['name'], WHO, Cost.of(r['ms']), names.get(r['name'], '') or _points(r))
            for r in self._run('stages', self._data, times)
        ]

    def pairs(self, shots: list[Shot]) -> list[Row]:
        """Voxel grid, normals and registration of pairs."""
        for old in self._data.glob('pair_*'):
            old.unlink()
        for k, (target, source) in enumerate(itertools.pairwise(shots)):
            self._write(f'pair_{k}_target', target.organised)
            self._write(f'pair_{k}_source', source.organised)
        rows = []
        for r in self._run('pairs', self._data):
            poses = np.array(r['poses']).reshape(-1, 4, 4)
            errors = [pair_error(T, a, b) for T, a, b in zip(poses, shots, shots[1:], strict=False)]
            rows.append(Row('pair', f'{WHO}: {r["name"]}', Cost.of(r['ms']), str(summary(errors))))
        return rows

    def lum(self, shots: list[Shot], edges: list[tuple[int, int]], name: str, outer: int) -> Row:
        """Lu-Milios 40x40; with fewer outer iterations measured, their mean times 40."""
        for k, shot in enumerate(shots):
            self._write(f'frame_{k}', shot.cloud)
        np.savetxt(self._data / 'start.txt', np.array(drifted(shots)).reshape(-1, 16))
        np.savetxt(self._data / 'edges.txt', np.array(edges), fmt='%d')
        (r,) = self._run('lum', self._data, outer, 'edges', 'lum')
        total = float(np.sum(r['ms'])) * LUM_OUTER / outer
        degrees, shift = pose_errors(list(np.array(r['poses']).reshape(-1, 4, 4)), shots)
        measured = (
            ''
            if outer == LUM_OUTER
            else f'; {outer} outer iterations measured, times {LUM_OUTER / outer:.0f}'
        )
        note = f'{degrees:.2f}°, {shift:.2f} mm{measured}' if outer == LUM_OUTER else measured.lstrip('; ')
        return Row(name, f'{WHO}: LUM 40x40', Cost.of([total]), note)

    def _write(self, name: str, points: NDArray[np.floating]) -> None:
        points.astype('<f4').tofile(self._data / f'{name}.f32')

    def _run(self, *arguments: Any) -> list[dict[str, Any]]:
        command = [str(self._program), *(str(a) for a in arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{')]


def merged_cloud(shots: Sequence[Shot]) -> Array:
    """All frames at their true poses in one cloud, one point a voxel of 2 mm: some 50 000 points."""
    points = np.concatenate([apply(inverse(s.pose), s.cloud) for s in shots])
    _, first = np.unique(np.floor(points / 0.002).astype(np.int64), axis=0, return_index=True)
    return points[first]


def _points(result: dict[str, Any]) -> str:
    return f'{result["points"]} points' if 'points' in result else ''
