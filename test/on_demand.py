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

"""What few tests need all of."""

from collections.abc import Callable, Sequence
from typing import Any, overload


class OnDemand(Sequence[Any]):
    """A sequence whose items are made when they are asked for.

    Args:
        count: how many there are.
        make: the item of an index; asked once for each.
    """

    def __init__(self, count: int, make: Callable[[int], Any]) -> None:
        self._indices, self._make = range(count), make
        self._made: dict[int, Any] = {}

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, k: int) -> Any: ...
    @overload
    def __getitem__(self, k: slice) -> list[Any]: ...
    def __getitem__(self, k: int | slice) -> Any:
        chosen = self._indices[k]
        if isinstance(chosen, range):
            return [self[n] for n in chosen]
        if chosen not in self._made:
            self._made[chosen] = self._make(chosen)
        return self._made[chosen]
