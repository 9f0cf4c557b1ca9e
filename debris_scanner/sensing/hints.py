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

"""What is odd about an input as a whole, in words, where that may be why its frames are of no use."""

import math

import numpy as np
from numpy.typing import NDArray

NOT_APART = (
    'what was followed reaches out of the view: the target was not told from what surrounds it '
    '(narrow isolation.box_min and box_max to it)'
)
NO_DEPTH = 'no pixel has a depth (a cloud has to be in the optical frame: x right, y down, z forward)'
SCALE = 'give metres a unit as --depth-scale, parameter depth_scale'
UNITS = {'millimetres': 0.001, 'centimetres': 0.01, 'inches': 0.0254}
_SAMPLE = 1000  # pixels that tell the median depth, and its step
_DISTINCT = 30  # depths that tell a step: that it takes to tell a step
_STEPS = range(2, 33)  # millimetres
_WHOLE_MM = 0.01  # from a whole number; single precision is as fine up to 100 m
_EXCESS = 0.5  # share of multiples beyond the one by chance; 0.73 and more with a step, 0.02 at most without


def stamp_hint(stamp_ns: int) -> str:
    """What is odd about frames that all have one stamp, ns: it identifies a frame, so one of them is used."""
    return f'all stamps are {stamp_ns}: the driver does not stamp its messages'


def unit_hint(depth: NDArray[np.float32], nearest: float, farthest: float) -> str:
    """Whether a depth image (h, w), metres, seems to be in another unit, or empty; '' if it does not.

    Its median lies where no target is looked for, and would not in the other unit: 16UC1 is read as
    millimetres, 32FC1 and clouds as metres.

    Args:
        depth: as it was read, 0 where invalid.
        nearest: a target is looked for from here, metres.
        farthest: up to here.
    """
    seen = depth[depth > 0]
    if not len(seen):
        return NO_DEPTH
    median = float(np.median(seen[:: max(1, len(seen) // _SAMPLE)]))
    if nearest <= median <= farthest:
        return ''
    if nearest <= median / 1000 <= farthest:
        what = 'depth looks like millimetres in a format that is in metres'
        return f'{what} (its median is {median:.4g} m): {SCALE}'
    if nearest <= median * 1000 <= farthest:
        what = 'depth looks like metres in a format that is in millimetres'
        return f'{what} (its median is {median:.4g} m): {SCALE}'
    return (
        f'the median depth is {median:.4g} m, a target is looked for from {nearest:g} to {farthest:g} m: '
        f'check the unit, and {SCALE}'
    )


def step_hint(depth: NDArray[np.float32]) -> str | None:
    """Whether a depth image (h, w), metres, has a coarser step than the millimetres that it is read as.

    A sensor's noise fills all whole numbers of its unit. Where most depths are multiples of one step, the
    file holds them in another unit or with its bits shifted, and all lengths are wrong by that factor.

    Args:
        depth: as it was read, 0 where invalid.

    Returns:
        The hint, '' if there is no step, None if too few different depths are seen to tell.
    """
    seen = depth[depth > 0]
    depths_mm = np.unique(1000 * seen[:: max(1, len(seen) // _SAMPLE)].astype(np.float64))
    whole = np.rint(depths_mm)
    if len(np.unique(whole)) < _DISTINCT:
        return None
    whole = whole[np.abs(depths_mm - whole) < _WHOLE_MM]
    excess = {step: np.sum(whole % step == 0) / len(depths_mm) - 1 / step for step in _STEPS}
    step = max(excess, key=lambda k: excess[k])
    if excess[step] < _EXCESS:
        return ''
    what = f'nearly all depths are multiples of {step} mm'
    return f'{what}: check the unit ({SCALE}), and whether bits are shifted'


def model_unit(extent: float, seen: float) -> str:
    """The unit that a model of an extent seems to be in, beside a target as large as ``seen``, metres.

    Empty where metres will do: a target shows at least a part of its extent.
    """
    ratio = extent / seen
    unit = min(UNITS, key=lambda name: abs(math.log(ratio * UNITS[name])))
    return unit if abs(math.log(ratio * UNITS[unit])) < abs(math.log(ratio)) and ratio > 1 else ''


def checked_unit(depth: NDArray[np.float32], farthest: float) -> None:
    """Check that a depth image (h, w) can be in metres.

    Raises:
        ValueError: all of it lies beyond where a target is looked for, and would not in millimetres.
    """
    seen = depth[depth > 0]
    if len(seen) and farthest < seen.min() and np.median(seen) <= 1000 * farthest:
        raise ValueError(
            f'depth is {seen.min():.4g} to {seen.max():.4g}, beyond {farthest:g} m everywhere: floats are '
            'metres; give millimetres as uint16'
        )


def joined(*hints: str) -> str:
    """All hints in one line."""
    return '; '.join(given(*hints))


def given(*hints: str) -> tuple[str, ...]:
    """The hints that say something."""
    return tuple(hint for hint in hints if hint)
