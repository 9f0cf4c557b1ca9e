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
