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

"""When the sensor saw a frame, on this machine's clock; a replay's stamps lie in the past."""

import time
from collections.abc import Mapping

# A live sensor's stamps are this close to the clock; anything further off is a recording.
_LIVE_S = 30.0


class SensorClock:
    """Turns stamps into times of the system's clock, nanoseconds.

    A player keeps the recorded stamps, which name the frames, and says in its diagnostics which of them
    it published when; a live sensor stamps with the clock itself.
    """

    def __init__(self) -> None:
        self._replay: tuple[int, int, float] | None = None

    def learn(self, values: Mapping[str, str]) -> None:
        """Take what a player says: first stamp, when it was published, and how fast it plays."""
        try:
            self._replay = (
                int(values['first_stamp_ns']),
                int(values['first_published_ns']),
                float(values['rate']),
            )
        except (KeyError, ValueError):
            return

    def age_s(self, stamp_ns: int, at_ns: int) -> float | None:
        """Age of a frame at a time of the system's clock; None where the stamps belong to another clock."""
        if self._replay is not None:
            first, published, rate = self._replay
            stamp_ns = published + round((stamp_ns - first) / rate)
        age = (at_ns - stamp_ns) * 1e-9
        return age if abs(age) < _LIVE_S else None


def replay_values(first_stamp_ns: int, first_published_ns: int, rate: float) -> dict[str, object]:
    """What a player says for :meth:`SensorClock.learn`."""
    return {'first_stamp_ns': first_stamp_ns, 'first_published_ns': first_published_ns, 'rate': rate}


def now_ns() -> int:
    """The system's clock, as the middleware reads it."""
    return time.time_ns()
