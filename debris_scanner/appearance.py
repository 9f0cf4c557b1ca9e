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

"""Whether a target that was out of sight is still coming into it: its outline is then what hides it."""

GROWTH = 0.5  # per second, of the points in sight: it is coming into sight
SPAN_NS = 90_000_000  # between the frames that are compared
LONGEST_NS = 1_000_000_000  # what grows for longer is turning its broad side to the sensor


class Appearance:
    """Takes the number of points frame by frame."""

    def __init__(self) -> None:
        self.emerging = False
        self._seen: list[tuple[int, int]] = []  # stamp and points, since it came into sight

    def note(self, stamp_ns: int, points: int, max_gap: float) -> None:
        """Take the next frame that shows the target; not seen for longer than max_gap, s, it was away."""
        if self._seen and stamp_ns - self._seen[-1][0] > max_gap * 1e9:
            self._seen, self.emerging = [], True
        if self.emerging:
            self.emerging = self._grows(stamp_ns, points)
        self._seen = [s for s in self._seen if stamp_ns - s[0] <= 2 * LONGEST_NS]
        self._seen.append((stamp_ns, points))

    def come_anew(self) -> None:
        """What showed so far was a part: the target is only now coming into sight."""
        self._seen, self.emerging = self._seen[-1:], True

    def _grows(self, stamp_ns: int, points: int) -> bool:
        if not self._seen:
            return True
        if stamp_ns - self._seen[0][0] > LONGEST_NS:
            return False
        earlier = [s for s in self._seen if stamp_ns - s[0] >= SPAN_NS]
        if not earlier:
            return True
        then_ns, before = earlier[-1]
        return points > before * (1 + GROWTH * (stamp_ns - then_ns) * 1e-9)
