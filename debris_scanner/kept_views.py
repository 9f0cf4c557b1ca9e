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

"""Views of key frames in bounded memory: the latest used stay prepared, the others keep their depth alone.

A prepared view of 250 x 150 pixels takes 1.2 MB, its depth, compressed, 12 kB. A view that is asked for
again is prepared anew in some three milliseconds: the same view, to the bit, where the camera measures in
whole millimetres, else to a tenth of one.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import overload

from debris_scanner.compact_frames import PackedFrame
from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array
from debris_scanner.normals import NormalSettings
from debris_scanner.views import View


class KeptViews(Sequence[View]):
    """Views by index, as a list of them; at most ``capacity`` are prepared at a time.

    Args:
        capacity: at least one.
        settings: of the normals, to fit them anew.
    """

    def __init__(self, capacity: int, settings: NormalSettings) -> None:
        self.capacity = capacity
        self.centroids: list[Array] = []  # of all views, (3,), view frame
        self._settings = settings
        self._packed: list[PackedFrame | None] = []  # None: never put away so far
        self._whole: list[bool] = []
        self._prepared: OrderedDict[int, View] = OrderedDict()  # least recently used first

    def __len__(self) -> int:
        return len(self._packed)

    def append(self, view: View) -> None:
        """Take a view."""
        self.centroids.append(view.centroid)
        self._packed.append(None)
        self._whole.append(view.whole)
        self._keep(len(self._packed) - 1, view)

    @overload
    def __getitem__(self, index: int) -> View: ...

    @overload
    def __getitem__(self, index: slice) -> list[View]: ...

    def __getitem__(self, index: int | slice) -> View | list[View]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = range(len(self))[index]  # raises as a list does
        view = self._prepared.get(k)
        if view is None:
            view = View(self.frame(k))
            view.whole = self._whole[k]
        self._keep(k, view)
        return view

    def is_whole(self, index: int) -> bool:
        """Whether a view shows the whole side, as far as is known."""
        return self._whole[index]

    def judge(self, index: int, whole: bool) -> None:
        """Note whether a view turned out to show the whole side."""
        self._whole[index] = whole
        if index in self._prepared:
            self._prepared[index].whole = whole

    def frame(self, index: int) -> TargetFrame:
        """A view's frame alone; what is not prepared stays so."""
        if index in self._prepared:
            return self._prepared[index].frame
        packed = self._packed[index]
        assert packed is not None
        return packed.restore(self._settings)

    @contextmanager
    def all_prepared(self) -> Iterator[None]:
        """Where every view is asked for again and again: prepare each but once, and keep all meanwhile."""
        capacity, self.capacity = self.capacity, max(self.capacity, len(self))
        try:
            yield
        finally:
            self.capacity = capacity
            self._put_away()

    def _keep(self, k: int, view: View) -> None:
        self._prepared[k] = view
        self._prepared.move_to_end(k)
        self._put_away()

    def _put_away(self) -> None:
        while len(self._prepared) > self.capacity:
            old, put_away = self._prepared.popitem(last=False)
            self._packed[old] = self._packed[old] or PackedFrame(put_away.frame)
