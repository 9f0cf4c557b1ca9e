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

"""Results of a scan: the records that summary.json and the pose files are written from."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array

# Why there is no model (summary.json: reason).
NO_TARGET = 'no_target'
CAMERA_INFO = 'camera_info'  # also of frames, in `rejected`
TOO_FEW_FRAMES = 'too_few_frames'
NO_CLOSURE = 'no_closure'
INCONSISTENT_MODEL = 'inconsistent_model'
NOT_RIGID = 'not_rigid'  # it changed while it was scanned
UNOBSERVABLE_ROTATION = 'unobservable_rotation'
INTERRUPTED = 'interrupted'
ERROR = 'error'  # every attempt at a model raised; of frames: what was done with one did
NO_MATCH = 'no_match'  # of a scan with a given model
NO_OVERLAP, AMBIGUOUS = 'no_overlap', 'ambiguous'  # of merged scans
_FEWEST, _MOST = 2, 17  # decimals; two doubles that differ do so within 17 significant digits


def compared(value: float, relation: str, bound: float, decimals: int = _FEWEST) -> str:
    """The comparison as text, with as many decimals as it takes to tell the two apart.

    Args:
        value: what was measured.
        relation: as '<' or 'not >='; it holds.
        bound: what it is compared with.
        decimals: at least so many.
    """
    if np.isfinite(value) and np.isfinite(bound) and value != bound:
        while f'{value:.{decimals}f}' == f'{bound:.{decimals}f}' and decimals < _MOST:
            decimals += 1
        if f'{value:.{decimals}f}' == f'{bound:.{decimals}f}':  # both are tiny
            return f'{value!r} {relation} {bound!r}'
    return f'{value:.{decimals}f} {relation} {bound:.{decimals}f}'


class Check(NamedTuple):
    """A number that decided: whether its value keeps to its bound."""

    name: str  # as in summary.json, with its unit unless it has none or is nats a point
    value: float
    bound: float | None = None  # None of a number that is given and decides nothing
    passed: bool = True

    @property
    def words(self) -> str:
        """The check for people: ``overlap 0.31 not >= 0.40``."""
        if self.bound is None:
            return f'{self.name} {self.value:.3g}'
        relation = '<=' if (self.value <= self.bound) == self.passed else '>='
        relation = relation if self.passed else f'not {relation}'
        whole = float(self.value).is_integer() and float(self.bound).is_integer()
        decimals = 0 if whole else max(_FEWEST, len(f'{self.bound:.3g}'.partition('.')[2]))
        return f'{self.name} {compared(self.value, relation, self.bound, decimals)}'


Checks = tuple[Check, ...]


def at_most(name: str, value: float, bound: float) -> Check:
    """The check that a value does not exceed a bound; NaN does."""
    return Check(name, float(value), float(bound), bool(value <= bound))


def at_least(name: str, value: float, bound: float) -> Check:
    """The check that a value reaches a bound; NaN does not."""
    return Check(name, float(value), float(bound), bool(value >= bound))


def passed(checks: Iterable[Check]) -> bool:
    """Whether all checks passed."""
    return all(check.passed for check in checks)


def in_words(checks: Sequence[Check], note: str = '') -> str:
    """A decision for people, the one place where it is made of its checks.

    Args:
        checks: all of the decision; where some failed, those that passed are left out.
        note: what they are about; empty: nothing is said of that.
    """
    asked = [c for c in checks if c.bound is not None]
    failed = [c for c in asked if not c.passed]
    given = [c for c in checks if c.bound is None]
    return ': '.join(filter(None, [note, ', '.join(c.words for c in [*(failed or asked), *given])]))


@dataclass(frozen=True, slots=True)
class StampedPose:
    """T_sensor_target (4, 4) of one frame."""

    stamp_ns: int
    T_sensor_target: Array


@dataclass(frozen=True, slots=True)
class RateSample:
    """Angular rate in the target frame, rad/s, with its standard deviation and the gate's verdict."""

    stamp_ns: int
    omega: Array  # (3,)
    sigma: Array  # (3,)
    accepted: bool


@dataclass(frozen=True)
class ClosureRecord:
    """One closure hypothesis with the numbers that decided it."""

    from_stamp_ns: int  # the earlier key frame
    to_stamp_ns: int
    probability: float  # joint, 0..1
    accepted: bool
    why: str  # its checks in words
    # (4, 4) as registered, between the sensor's frames; None where the two views were never registered.
    # Records that differ in it alone compare equal, because arrays do not compare.
    T_from_to: Array | None = field(default=None, compare=False)
    checks: Checks = ()


@dataclass(frozen=True)
class GraphEdge:
    """Edge of the pose graph: T_i_j between key frames i < j with its information matrix (6, 6)."""

    i: int
    j: int
    T_i_j: Array
    information: Array  # ordered translation, rotation as g2o's EDGE_SE3:QUAT


@dataclass(frozen=True)
class Forecast:
    """Poses and rates after the last frame, with standard deviations of one sigma."""

    stamps_ns: list[int]
    poses: Array  # (n, 4, 4), T_sensor_target
    rates: Array  # (n, 3), rad/s, target frame
    position_sigma: Array  # (n, 3), m, along the sensor's axes
    attitude_sigma: Array  # (n, 3), rad, about the target's axes
    rate_sigma: Array  # (n, 3), rad/s


@dataclass(frozen=True)
class Descriptions:
    """Descriptors of the key frames in a closure detector, in order of time."""

    stamps_ns: NDArray[np.int64]  # (n,)
    histograms: NDArray[np.float32]  # (n, 180), EFPFH
    attitudes: Array  # (n, 3, 3), R_target_sensor as estimated when each was described


def commonest(rejected: Mapping[str, int]) -> str:
    """The reason that most frames were rejected for; empty if none was."""
    return max(rejected, key=lambda reason: rejected[reason], default='')
