"""Times when the target cannot be seen: it blinks out for seconds and comes and goes piecemeal."""

from dataclasses import dataclass

import numpy as np

_FIRST_S = 4.0  # nothing is hidden before
_LENGTH_S = (1.0, 3.0)
_SIGHT_S = (5.0, 9.0)  # in sight between two gaps
_RAMP_S = 0.5  # a shadow's edge takes this long to cross the target


@dataclass(frozen=True)
class Gaps:
    """Intervals (start, end) in seconds during which nothing of the target shows."""

    intervals: tuple[tuple[float, float], ...]

    @staticmethod
    def draw(duration_s: float, seed: int) -> 'Gaps':
        """Gaps of 1 to 3 s, 5 to 9 s apart, over the given time."""
        rng = np.random.default_rng([seed, 2])
        intervals = []
        start = _FIRST_S + float(rng.uniform(0.0, 2.0))
        while start < duration_s:
            end = start + float(rng.uniform(*_LENGTH_S))
            intervals.append((start, end))
            start = end + float(rng.uniform(*_SIGHT_S))
        return Gaps(tuple(intervals))

    def visibility(self, t_s: float) -> float:
        """Share of the target that shows at t_s: 0 in a gap, rising from and falling to it in 0.5 s."""
        distance = min((max(a - t_s, t_s - b, 0.0) for a, b in self.intervals), default=np.inf)
        return min(distance / _RAMP_S, 1.0)
