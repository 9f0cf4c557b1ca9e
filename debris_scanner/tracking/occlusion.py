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

"""Whether a target that was out of sight is still coming into it: its outline is then what hides it.

What may hide a part of the target: does a frame show the whole side, and what serves while none does?

Coming into sight, the target grows. Later, a part is missing of what a whole view has shown. And a scan that
began half hidden shows more, by and by, than all its key frames.
"""

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.sensing.views import View
from debris_scanner.tracking.gating import FrameFit, OdometrySettings, Reference
from debris_scanner.tracking.motion_filter import MotionFilter

GROWTH = 0.5  # per second, of the points in sight: it is coming into sight
SPAN_NS = 90_000_000  # between the frames that are compared
LONGEST_EMERGING_NS = 1_000_000_000  # what grows for longer is turning its broad side to the sensor


class Appearance:
    """Takes the number of points frame by frame."""

    def __init__(self) -> None:
        self.entering_view = False
        self._seen: list[tuple[int, int]] = []  # stamp and points, since it came into sight

    def note(self, stamp_ns: int, points: int, max_gap: float) -> None:
        """Take the next frame that shows the target; not seen for longer than max_gap, s, it was away."""
        if self._seen and stamp_ns - self._seen[-1][0] > max_gap * 1e9:
            self._seen, self.entering_view = [], True
        if self.entering_view:
            self.entering_view = self._grows(stamp_ns, points)
        self._seen = [s for s in self._seen if stamp_ns - s[0] <= 2 * LONGEST_EMERGING_NS]
        self._seen.append((stamp_ns, points))

    def come_anew(self) -> None:
        """What showed so far was a part: the target is only now coming into sight."""
        self._seen, self.entering_view = self._seen[-1:], True

    def _grows(self, stamp_ns: int, points: int) -> bool:
        if not self._seen:
            return True
        if stamp_ns - self._seen[0][0] > LONGEST_EMERGING_NS:
            return False
        earlier = [s for s in self._seen if stamp_ns - s[0] >= SPAN_NS]
        if not earlier:
            return True
        then_ns, before = earlier[-1]
        return points > before * (1 + GROWTH * (stamp_ns - then_ns) * 1e-9)


PARTIAL_VIEWS = 4  # the latest of them bridge the time until the whole side is seen again
LONGEST_OCCLUSION_NS = 3_000_000_000  # half hidden for longer, what shows is all there is


class Occlusion:
    """Takes every frame, and what it fitted. ``partial``: the latest half hidden views, with their poses."""

    def __init__(self) -> None:
        self.partial: list[Reference] = []
        self._appearance = Appearance()
        self._settled: tuple[MotionFilter, int] | None = None  # when the whole side was last seen

    @property
    def entering_view(self) -> bool:
        """The target is coming into sight: the edge that it seems to have is that of what hides it."""
        return self._appearance.entering_view

    def note(self, view: View, max_gap: float) -> None:
        """Take the next frame that shows the target; not seen for longer than max_gap, s, it was away."""
        self._appearance.note(view.frame.stamp_ns, len(view.points), max_gap)

    def hides(self, fit: FrameFit, stamp_ns: int, settings: OdometrySettings) -> bool:
        """Something hides a part in a frame; or did lately, and no whole view tells that it does no more."""
        if fit.has_unoccluded_reference or self._settled is None:
            return fit.missing_reference_ratio > settings.max_keyframe_missing_reference
        return stamp_ns - self._settled[1] < LONGEST_OCCLUSION_NS

    def take(self, view: View, motion: MotionFilter) -> None:
        """Keep what a believed frame says, whole or half hidden; what shows of the latter may slide."""
        if view.unoccluded:
            self._settled = motion.copy(), view.frame.stamp_ns
        else:
            self.partial = [*self.partial[1 - PARTIAL_VIEWS :], (view, inverse(motion.T_sensor_target))]

    def uncover(self, references: list[Reference]) -> None:
        """What was taken for whole turns out to be half hidden: the target is still coming into sight."""
        for surface, _ in references:
            surface.unoccluded = False
        self.partial = references[-PARTIAL_VIEWS:]
        self._settled = None
        self._appearance.come_anew()

    def last_unoccluded(self) -> tuple[MotionFilter, int] | None:
        """A copy of the filter when the whole side was last seen, and the stamp."""
        return (self._settled[0].copy(), self._settled[1]) if self._settled is not None else None

    def change_target_frame(self, T_new_old: Array) -> None:
        """Follow a change of the target frame."""
        if self._settled is not None:
            self._settled[0].change_target_frame(T_new_old)
        self.partial = [(view, T_new_old @ T) for view, T in self.partial]
