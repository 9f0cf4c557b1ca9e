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

"""Where the sensor was: an odometry of it, by which poses in its frame become poses in the world's."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from threading import Lock

import numpy as np
import scipy

from debris_scanner.core.geometry import Array, inverse, transform
from debris_scanner.core.results import StampedPose

SENSOR, ODOMETRY = 'sensor', 'odometry'  # mass_properties.frame
KEPT = 200_000  # samples: half an hour at 100 Hz
LOST = 10  # intervals: a wider gap between samples is not bridged


@dataclass(frozen=True)
class Placed:
    """Poses of a target in the frame in which its dynamics are fitted."""

    poses: list[StampedPose]  # T_frame_target
    frame: str  # SENSOR or ODOMETRY
    T_sensor_frame: Array  # (4, 4) at the last pose
    sigma_rad: float  # standard deviation of the sensor's own rotation about each axis
    why_not: str = ''  # an odometry that was given is not used


class SensorPath:
    """Samples of the sensor's pose in a frame that does not turn. Thread-safe."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Array, float]] = deque(maxlen=KEPT)
        self._of, self._seen = '', ''  # frame ids: of the odometry, and of the target's frames
        self._lock = Lock()

    def sees(self, frame_id: str) -> None:
        """The sensor's frame id; an odometry of another frame, as of a vehicle's base, is not used."""
        with self._lock:
            self._seen = frame_id

    def add(self, stamp_ns: int, T_world_sensor: Array, sigma_rad: float = 0.0, frame_id: str = '') -> None:
        """Add a sample (4, 4), the standard deviation of its rotation, and whose pose it is.

        One that is not newer is left out; one as old as the first begins anew.
        """
        with self._lock:
            if self._samples and stamp_ns <= self._samples[0][0]:
                self._samples.clear()
            if not self._samples or stamp_ns > self._samples[-1][0]:
                self._samples.append((stamp_ns, T_world_sensor, sigma_rad))
                self._of = frame_id

    def place(self, poses: Sequence[StampedPose]) -> Placed:
        """Poses T_sensor_target, in order of time, in the world; in the sensor's frame where that is unknown.

        Between samples it is interpolated, and kept on for an interval at most beyond the ends.
        """
        with self._lock:
            samples, of, seen = list(self._samples), self._of, self._seen
        given = list(poses)
        if not given or not samples:
            return Placed(given, SENSOR, np.eye(4), 0.0)
        why_not = _uncovered([s for s, *_ in samples], [p.stamp_ns for p in given])
        if of and seen and of != seen:
            why_not = f"the sensor's odometry is of frame {of!r}, and the sensor's frame is {seen!r}"
        if why_not:
            return Placed(given, SENSOR, np.eye(4), 0.0, why_not)
        seconds = np.array([(s - samples[0][0]) * 1e-9 for s, *_ in samples])
        T = np.array([sample[1] for sample in samples])
        wanted = np.array([(p.stamp_ns - samples[0][0]) * 1e-9 for p in given])
        placed = _interpolated(seconds, T, wanted)
        world = [StampedPose(p.stamp_ns, S @ p.T_sensor_target) for p, S in zip(given, placed, strict=True)]
        sigma = float(np.median([sample[2] for sample in samples]))
        return Placed(world, ODOMETRY, inverse(placed[-1]), sigma)


def _uncovered(samples_ns: Sequence[int], wanted_ns: Sequence[int]) -> str:
    """Why the samples do not tell of all these times; empty if they do."""
    if len(samples_ns) < 2:
        return "the sensor's odometry has a single sample"
    interval = float(np.median(np.diff(samples_ns)))
    before = samples_ns[0] - interval - wanted_ns[0]
    after = wanted_ns[-1] - samples_ns[-1] - interval
    if max(before, after) > 0:
        end = 'begins after the first frames' if before > 0 else 'ends before the last frames'
        return f"the sensor's odometry {end}, by {(max(before, after) + interval) * 1e-9:.2f} s"
    at = np.searchsorted(wanted_ns, samples_ns)
    for k, (a, b) in enumerate(pairwise(samples_ns)):
        if b - a > LOST * interval and at[k + 1] > at[k]:
            return f"the sensor's odometry has a gap of {(b - a) * 1e-9:.2f} s"
    return ''


def _interpolated(seconds: Array, T: Array, wanted: Array) -> Array:
    """Poses (m, 4, 4) at wanted (m,) of samples (n, 4, 4), on a geodesic in between and beyond the ends."""
    last = np.clip(np.searchsorted(seconds, wanted, side='right'), 1, len(seconds) - 1)
    inside = np.clip(wanted, seconds[0], seconds[-1])
    turns = scipy.spatial.transform.Rotation.from_matrix(T[:, :3, :3])
    R = scipy.spatial.transform.Slerp(seconds, turns)(inside)
    share = (wanted - seconds[last - 1]) / (seconds[last] - seconds[last - 1])
    p = T[last - 1, :3, 3] + share[:, None] * (T[last, :3, 3] - T[last - 1, :3, 3])
    # beyond an end, at the rate of the interval there
    first, then = turns[last - 1], turns[last]
    rate = (first.inv() * then).as_rotvec() / (seconds[last] - seconds[last - 1])[:, None]
    R = R * scipy.spatial.transform.Rotation.from_rotvec(rate * (wanted - inside)[:, None])
    return np.array([transform(*pose) for pose in zip(R.as_matrix(), p, strict=True)])
