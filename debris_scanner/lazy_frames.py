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

"""Frames with their poses that are restored when they are asked for."""

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, overload

from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array

Kept = TypeVar('Kept')
Posed = tuple[TargetFrame, Array]  # T_target_sensor (4, 4)


class LazyFrames(Sequence[Posed], Generic[Kept]):
    """Posed frames, each restored anew whenever it is asked for.

    Hundreds of frames with their normals take as many megabytes; to restore one takes a millisecond.

    Args:
        kept: what is kept of each frame.
        restore: makes a frame and its pose of it.
    """

    def __init__(self, kept: Sequence[Kept], restore: Callable[[Kept], Posed]) -> None:
        self._kept = kept
        self._restore = restore

    def __len__(self) -> int:
        return len(self._kept)

    @overload
    def __getitem__(self, index: int) -> Posed: ...

    @overload
    def __getitem__(self, index: slice) -> 'LazyFrames[Kept]': ...

    def __getitem__(self, index: int | slice) -> 'Posed | LazyFrames[Kept]':
        if isinstance(index, slice):
            return LazyFrames(self._kept[index], self._restore)
        return self._restore(self._kept[index])
