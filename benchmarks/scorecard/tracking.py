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

"""Tracking after the first model: errors of the live estimates, lost frames, re-acquisition."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.evaluation.trajectory_errors import Poses, align, pose_errors
from debris_scanner.tracking.odometry import LOST

WRONG_RAD = np.radians(5.0)  # an estimate with a larger error is no re-acquisition


@dataclass(frozen=True)
class Tracked:
    """The live estimate of one frame after the model; ``T_sensor_target`` None where it was not accepted."""

    stamp_ns: int
    state: str
    T_sensor_target: Array | None


def tracking_figures(
    tracked: Sequence[Tracked], truth: Poses, visibility: Callable[[int], float]
) -> dict[str, Any] | None:
    """Figures of the frames after the model, all of them in order; None if nothing was tracked.

    Errors are those of the accepted unoccluded frames; ``partial_max_deg`` is the largest of the other
    accepted ones. ``missed``: unoccluded frames that were not accepted. ``lost``: those of them during which
    the target counted as lost. ``wrong``: accepted, and more than 5 degrees off. ``gaps``: of each the length
    and the time from the first sight after it to the first right estimate, None without one.

    Args:
        tracked: frames after the model.
        truth: true T_sensor_target by stamp.
        visibility: share of the target that shows, by stamp.
    """
    accepted = {t.stamp_ns: t.T_sensor_target for t in tracked if t.T_sensor_target is not None}
    if not accepted.keys() & truth.keys():
        return None
    attitude, position = pose_errors(truth, accepted, align(truth, accepted))
    attitude_deg, position_mm = np.degrees(attitude), position * 1e3
    right = dict(zip(sorted(accepted), attitude <= WRONG_RAD, strict=True))
    shows = np.array([visibility(s) >= 1 for s in sorted(accepted)])
    unoccluded = [t for t in tracked if visibility(t.stamp_ns) >= 1]
    gaps = _gaps(tracked, right, visibility)
    waits = [g['reacquired_s'] for g in gaps]
    return {
        'seconds': round((tracked[-1].stamp_ns - tracked[0].stamp_ns) * 1e-9, 3),
        'frames': len(tracked),
        'attitude_rms_deg': _rms(attitude_deg[shows]),
        'attitude_max_deg': _largest(attitude_deg[shows]),
        'position_rms_mm': _rms(position_mm[shows]),
        'position_max_mm': _largest(position_mm[shows]),
        'partial_max_deg': _largest(attitude_deg[~shows]),
        'missed': sum(t.T_sensor_target is None for t in unoccluded),
        'lost': sum(t.T_sensor_target is None and t.state == LOST for t in unoccluded),
        'wrong': int((attitude > WRONG_RAD).sum()),
        'gaps': gaps,
        'reacquired_s': max((w for w in waits if w is not None), default=None),
        'never_reacquired': sum(w is None for w in waits),
    }


def _rms(values: Array) -> float | None:
    return round(float(np.sqrt(np.mean(values**2))), 4) if len(values) else None


def _largest(values: Array) -> float | None:
    return round(float(values.max()), 4) if len(values) else None


def _gaps(
    tracked: Sequence[Tracked], right: dict[int, bool], visibility: Callable[[int], float]
) -> list[dict[str, float | None]]:
    """Of each gap that ended: its length, and how long it took to find the target again."""
    stamps = [t.stamp_ns for t in tracked]
    dark = [visibility(s) <= 0 for s in stamps]
    starts = [b for b in range(1, len(dark)) if dark[b] and not dark[b - 1]]
    ends = [b for b in range(1, len(dark)) if dark[b - 1] and not dark[b]]
    gaps = []
    for start in starts:
        end = next((e for e in ends if e > start), None)
        if end is None:
            continue
        until = next((s for s in starts if s > end), len(stamps))
        found = next((s for s in stamps[end:until] if right.get(s)), None)
        gaps.append(
            {
                'gap_s': round((stamps[end] - stamps[start]) * 1e-9, 3),
                'reacquired_s': None if found is None else round((found - stamps[end]) * 1e-9, 3),
            }
        )
    return gaps
