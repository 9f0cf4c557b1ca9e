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

"""Depth frame in, target frame out: box, target isolation, window, normals."""

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from debris_scanner.core.frames import DepthFrame, FrameRejected, TargetFrame, UnfittedFrame
from debris_scanner.core.timing import StageTimer
from debris_scanner.sensing.hints import NOT_APART, given, stamp_hint, step_hint, unit_hint
from debris_scanner.sensing.isolation import IsolationSettings, TargetIsolator
from debris_scanner.sensing.normals import Image, NormalSettings, fit_normals
from debris_scanner.sensing.silhouette import MARGIN_PX


class Preprocessor:
    """First stage of the scanner; keeps the last stamp, where the target was, and what stands still."""

    def __init__(
        self, isolation: IsolationSettings, normals: NormalSettings, timer: StageTimer | None = None
    ) -> None:
        self.isolation = isolation
        self.normals = normals
        self.timer = timer or StageTimer()
        self.reset()

    def reset(self) -> None:
        """Forget the target and the last stamp."""
        self._isolator = TargetIsolator(self.isolation)
        self._last_stamp_ns: int | None = None
        self._repeated = self._differ = False  # stamps
        self._plausible = False  # there was a target, and depth where one is looked for
        self._units = ''
        self._step: str | None = None  # the hint of the first frame that tells

    def configure(self, isolation: IsolationSettings) -> None:
        """Change where to look for the target; where it was last seen is kept."""
        self.isolation = isolation
        self._isolator.settings = isolation

    @property
    def background_warning(self) -> str:
        """Warning about still background in the box; empty without any."""
        pixels = self._isolator.still_pixels
        if not pixels:
            return ''
        return (
            f'{pixels} pixels in the box stand still and are left out: '
            'narrow isolation.box_min and box_max to the target'
        )

    @property
    def unit_warning(self) -> str:
        """Warning about the unit of all depths, whatever is seen in them; empty without any."""
        return self._step or ''

    @property
    def hints(self) -> tuple[str, ...]:
        """What is odd about the frames, if most of them show no target."""
        last_ns = self._last_stamp_ns
        told = last_ns is not None and self._repeated and not self._differ
        reaches_out = 2 * self._isolator.cut > self._isolator.found > 0
        return given(self._units, stamp_hint(last_ns or 0) if told else '', NOT_APART if reaches_out else '')

    @contextlib.contextmanager
    def looking_back(self) -> Iterator[Callable[[DepthFrame], TargetFrame]]:
        """What tells the targets of earlier frames, rejected as ``settling``, by what is known by now.

        The latest of them comes first: its target is nearest to where the target was seen.
        """

        def target_of(frame: DepthFrame) -> TargetFrame:
            mask = self._isolator.mask(frame.depth, frame.camera, frame.stamp_ns, learn=False)
            return self._target(self._window(frame, mask))

        with self._isolator.looking_back():
            yield target_of

    def process(self, frame: DepthFrame) -> TargetFrame:
        """The target's window of a depth frame.

        Raises:
            FrameRejected: ``non_monotone_stamp``, ``no_target`` or ``settling``.
        """
        last_ns = self._last_stamp_ns
        if last_ns is not None:
            self._repeated |= frame.stamp_ns == last_ns
            self._differ |= frame.stamp_ns != last_ns
            if frame.stamp_ns <= last_ns:
                raise FrameRejected('non_monotone_stamp', f'{frame.stamp_ns} after {last_ns}')
        self._last_stamp_ns = frame.stamp_ns
        if self._step is None:
            self._step = step_hint(frame.depth)
        with self.timer.stage('isolate'):
            return self._target(self._window(frame, self._mask(frame)))

    def _mask(self, frame: DepthFrame) -> np.ndarray:
        """The target's pixels; until there was one, depth that lies where none is looked for is noted."""
        low, high = self.isolation.box_min[2], self.isolation.box_max[2]
        units = '' if self._plausible else unit_hint(frame.depth, low, high)
        try:
            mask = self._isolator.mask(frame.depth, frame.camera, frame.stamp_ns)
        except FrameRejected:
            self._units = units
            raise
        if not units:
            self._plausible, self._units = True, ''
        return mask

    def _target(self, cropped: DepthFrame) -> TargetFrame:
        def fit() -> tuple[Image, Image]:
            with self.timer.stage('normals'):
                return fit_normals(cropped.depth, cropped.camera, self.normals)

        return UnfittedFrame.of(cropped.stamp_ns, cropped.camera, cropped.depth, cropped.rgb, fit)

    def _window(self, frame: DepthFrame, mask: np.ndarray) -> DepthFrame:
        """The masked depth, cropped to the target with a free border, as far as the image goes."""
        assert self._isolator.region is not None
        v0, v1, u0, u1 = self._isolator.region
        inner, (height, width) = (slice(v0, v1), slice(u0, u1)), mask.shape
        above, below = min(MARGIN_PX, v0), min(MARGIN_PX, height - v1)
        left, right = min(MARGIN_PX, u0), min(MARGIN_PX, width - u1)
        depth = np.zeros((above + v1 - v0 + below, left + u1 - u0 + right), np.float32)
        window = depth[above : above + v1 - v0, left : left + u1 - u0]
        np.multiply(frame.depth[inner], mask[inner], out=window)
        rgb = None if frame.rgb is None else np.pad(frame.rgb[inner], ((above, below), (left, right), (0, 0)))
        camera = frame.camera.crop(u0 - left, v0 - above, depth.shape[1], depth.shape[0])
        return DepthFrame(frame.stamp_ns, depth, camera, rgb)
