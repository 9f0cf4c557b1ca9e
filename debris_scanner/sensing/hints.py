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

import numpy as np
from numpy.typing import NDArray

UNSTAMPED = 'all stamps are 0: the driver does not stamp its messages'
NO_DEPTH = 'no pixel has a depth (a cloud has to be in the optical frame: x right, y down, z forward)'
_SAMPLE = 1000  # pixels that tell the median depth


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
        return f'depth looks like millimetres in a format that is in metres (its median is {median:.4g} m)'
    if nearest <= median * 1000 <= farthest:
        return f'depth looks like metres in a format that is in millimetres (its median is {median:.4g} m)'
    return (
        f'the median depth is {median:.4g} m, a target is looked for from {nearest:g} to {farthest:g} m: '
        'check the unit'
    )


def joined(*hints: str) -> str:
    """All hints in one line."""
    return '; '.join(hint for hint in hints if hint)
