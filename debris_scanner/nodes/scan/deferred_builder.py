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

"""A model builder that works in a thread of its own, for a scanner that must not wait for a model."""

from collections.abc import Callable
from functools import partial
from typing import Any

from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.nodes.lifecycle.worker import Worker


class DeferredBuilder:
    """Takes what the scanner gives its builder, at once, and hands it over to the worker, in order.

    All that one frame gives goes over as one task: no model is made of half of it. The scanner never
    generates by itself, for nothing is ever ``should_rebuild``; whoever owns the worker looks at the
    real builder between its tasks. All else is the builder's, and for the worker's thread to ask.

    Args:
        builder: that only the worker touches from now on.
        worker: that does the work.
    """

    due = False

    def __init__(self, builder: ModelBuilder, worker: Worker) -> None:
        self._builder = builder
        self._worker = worker
        self._calls: list[Callable[[], object]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._builder, name)

    def hand_over(self, then: Callable[[], object] | None = None) -> None:
        """Give the worker what was taken since the last time, and something to do after it."""
        calls, self._calls = [*self._calls, *([then] if then else [])], []
        if calls:
            self._worker.post(lambda: [call() for call in calls])

    def reset(self) -> None:
        """Forget the scan, after what was taken before."""
        self._calls.append(self._builder.reset)

    def add_frame(self, frame: TargetFrame, T_target_sensor: Array, tracked: bool) -> None:
        """As the builder's."""
        self._calls.append(partial(self._builder.add_frame, frame, T_target_sensor, tracked))

    def add_keyframe(self, keyframe: KeyFrame, tracked: bool) -> None:
        """As the builder's."""
        self._calls.append(partial(self._builder.add_keyframe, keyframe, tracked))

    def add_closure(self, closure: Closure) -> None:
        """As the builder's."""
        self._calls.append(partial(self._builder.add_closure, closure))
