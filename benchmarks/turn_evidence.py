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

"""``python -m benchmarks.turn_evidence``: how much of a turn shows, before each sensor.

Turned by ten degrees about the axis that shows it least, a target's surface moves by so much (rms); the rest
of the row is that as a share of the noise of one pixel that faces the sensor, at the sensor's range and size.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.scorecard.tables import markdown
from benchmarks.scorecard.targets import (
    NOTHING,
    RECORDING,
    STRANGER,
    TARGETS,
    ScoredTarget,
    available,
    mesh_file,
)
from debris_scanner.core.geometry import exp_so3
from debris_scanner.sim.sensors import KINECT1, SENSORS, SensorModel
from debris_scanner.sim.surface import Surface, sample_mesh
from debris_scanner.sim.targets import make_target

_WITHOUT_SHAPE = (NOTHING, RECORDING, STRANGER)
TURN = np.radians(10.0)
POINTS = 4000


def moved_by_a_turn(vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> float:
    """RMS distance, in the mesh's unit, from the surface turned about the principal axis that shows least."""
    points = sample_mesh(vertices, triangles, POINTS)
    surface, centre = Surface(vertices, triangles), points.mean(axis=0)
    axes = np.linalg.eigh(np.cov((points - centre).T))[1].T
    turned = [(points - centre) @ exp_so3(TURN * axis).T + centre for axis in (*axes, *-axes)]
    return float(min(np.sqrt(np.mean(surface.distance(p) ** 2)) for p in turned))


def noise(sensor: SensorModel) -> float:
    """Standard deviation, m, of a pixel that faces the sensor at its range."""
    return float(sensor.sigma(np.array(sensor.range_m, np.float32), np.array(1.0, np.float32)))


def row(target: ScoredTarget, sensors: list[SensorModel]) -> list[str]:
    """A line of the table."""
    mesh = mesh_file(target)
    body = make_target(target.name if mesh is None else mesh, target.size)
    size = float(np.ptp(body.vertices, axis=0).max())
    moved = moved_by_a_turn(body.vertices, body.triangles)
    shares = (moved * (s.size_m or size) / size / noise(s) for s in sensors)
    return [target.name, f'{1e3 * moved:.2f}', *(f'{share:.2f}' for share in shares)]


def main() -> None:
    sensors = [s for name, s in SENSORS.items() if name != KINECT1]
    targets = [t for t in TARGETS.values() if t.kind not in _WITHOUT_SHAPE and available(t)]
    print(markdown(['target', 'mm', *(s.name for s in sensors)], [row(t, sensors) for t in targets]))


if __name__ == '__main__':
    main()
