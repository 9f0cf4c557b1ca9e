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

"""Which scan a message belongs to, when a reset and the first frames of the new scan overtake each other."""

import time

# A reset that comes this soon after a new scan has shown itself is the one that began it.
_SAME_RESET_S = 3.0

NEW, SAME, STALE = 'new', 'same', 'stale'


class ScanIdentity:
    """Follows the scans by the stamps of their first key frames, which every verdict carries."""

    def __init__(self) -> None:
        self._scan_ns: int | None = None
        self._stale_ns: int | None = None
        self._began_s = float('-inf')

    def of(self, scan_ns: int) -> str:
        """``new`` for the first message of a scan, ``same`` for the next ones, ``stale`` after its reset."""
        if scan_ns == self._stale_ns:
            return STALE
        if scan_ns == self._scan_ns:
            return SAME
        if self._scan_ns is not None:
            self._stale_ns = self._scan_ns
            self._began_s = time.monotonic()
        self._scan_ns = scan_ns
        return NEW

    def reset(self) -> bool:
        """A reset was asked for; False if the scan after it has begun already."""
        if time.monotonic() - self._began_s < _SAME_RESET_S:
            return False
        self._stale_ns, self._scan_ns = self._scan_ns, None
        return True
