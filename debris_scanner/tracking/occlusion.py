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

"""Detects what occludes the target, and keeps what serves as reference meanwhile.

The silhouette of an occluded target is partly that of the occluder. :class:`ViewEntry` tells whether a target
that was out of sight is still entering the view: it grows. :class:`Occlusion` also tells whether a frame
lacks a part that an unoccluded view has shown, and handles a scan that began partially occluded: its frames
later show more than all its key frames do.
"""

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.sensing.views import View
from debris_scanner.tracking.gating import FrameFit, OdometrySettings, Reference, ScanLevel
from debris_scanner.tracking.motion_filter import MotionFilter

# Times hold at 10 Hz; slower sensors stretch them (cadence.py).
GROWTH = 0.5  # per second, of the number of points: the target is entering the view
SPAN_NS = 90_000_000  # between the frames that are compared
LONGEST_ENTRY_NS = 1_000_000_000  # a target that grows for longer is turning its broad side to the sensor
PARTIAL_VIEWS = 4  # the latest of them serve as references until an unoccluded view comes
LONGEST_OCCLUSION_NS = 3_000_000_000  # after longer the visible part counts as the whole target


class ViewEntry:
    """Detects a target that is entering the view, from the number of its points."""

    def __init__(self) -> None:
        self.entering_view = False
        self._stretch = 1.0
        self._points: list[
            tuple[int, int]
        ] = []  # stamp and number of points, since the target came into view

    def add(self, stamp_ns: int, points: int, max_gap: float, stretch: float = 1.0) -> None:
        """Add the next frame that shows the target; after more than max_gap, s, it was out of sight."""
        self._stretch = stretch
        if self._points and stamp_ns - self._points[-1][0] > max_gap * 1e9:
            self._points, self.entering_view = [], True
        if self.entering_view:
            self.entering_view = self._grows(stamp_ns, points)
        self._points = [p for p in self._points if stamp_ns - p[0] <= 2 * LONGEST_ENTRY_NS * stretch]
        self._points.append((stamp_ns, points))

    def restart(self) -> None:
        """The target is entering the view only now: earlier frames showed a part of it."""
        self._points, self.entering_view = self._points[-1:], True

    def _grows(self, stamp_ns: int, points: int) -> bool:
        if not self._points:
            return True
        if stamp_ns - self._points[0][0] > LONGEST_ENTRY_NS * self._stretch:
            return False
        earlier = [p for p in self._points if stamp_ns - p[0] >= SPAN_NS * self._stretch]
        if not earlier:
            return True
        then_ns, before = earlier[-1]
        return points > before * (1 + GROWTH / self._stretch * (stamp_ns - then_ns) * 1e-9)


class Occlusion:
    """Whether the frames of a scan show the target unoccluded.

    ``partial``: the latest partially occluded views, with their poses.
    """

    def __init__(self) -> None:
        self.partial: list[Reference] = []
        self._entry = ViewEntry()
        self._stretch = 1.0
        self._last_unoccluded: tuple[MotionFilter, int] | None = None

    @property
    def entering_view(self) -> bool:
        """The target is entering the view: its apparent silhouette is partly that of the occluder."""
        return self._entry.entering_view

    def add(self, stamp_ns: int, points: int, max_gap: float, stretch: float = 1.0) -> None:
        """Add the next frame that shows the target; after more than max_gap, s, it was out of sight."""
        self._stretch = stretch
        self._entry.add(stamp_ns, points, max_gap, stretch)

    def hides(self, fit: FrameFit, level: ScanLevel, stamp_ns: int, settings: OdometrySettings) -> bool:
        """Whether the target is occluded in a frame; without an unoccluded reference, as it was lately."""
        if fit.has_unoccluded_reference or self._last_unoccluded is None:
            return level.lacks(fit, settings.max_keyframe_missing_reference)
        return stamp_ns - self._last_unoccluded[1] < LONGEST_OCCLUSION_NS * self._stretch

    def keep(self, view: View, motion: MotionFilter) -> None:
        """Keep an accepted frame: the filter of an unoccluded view, or a partially occluded view itself."""
        if view.unoccluded:
            self._last_unoccluded = motion.copy(), view.frame.stamp_ns
        else:
            self.partial = [*self.partial[1 - PARTIAL_VIEWS :], (view, inverse(motion.T_sensor_target))]

    def mark_occluded(self, references: list[Reference]) -> None:
        """References that counted as unoccluded are not: the target is still entering the view."""
        for surface, _ in references:
            surface.unoccluded = False
        self.partial = references[-PARTIAL_VIEWS:]
        self._last_unoccluded = None
        self._entry.restart()

    def last_unoccluded(self) -> tuple[MotionFilter, int] | None:
        """A copy of the filter at the last unoccluded view, and its stamp."""
        last = self._last_unoccluded
        return None if last is None else (last[0].copy(), last[1])

    def change_target_frame(self, T_new_old: Array) -> None:
        """Follow a change of the target frame."""
        if self._last_unoccluded is not None:
            self._last_unoccluded[0].change_target_frame(T_new_old)
        self.partial = [(view, T_new_old @ T) for view, T in self.partial]
