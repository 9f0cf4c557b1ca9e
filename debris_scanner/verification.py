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

"""Geometric verification of a loop closure: do two views really show the same surface?"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.geometry import Array, apply, compose, inverse, rotation_angle
from debris_scanner.parameters import parameter
from debris_scanner.registration import Agreement, register
from debris_scanner.views import View


@dataclass(frozen=True)
class VerificationSettings:
    """Bounds that a closure must keep; they tell front from back, not one symmetric face from another."""

    min_overlap: float = parameter(0.72, 'share of the points that must match', '', 0.0, 1.0)
    max_rms: float = parameter(0.0025, 'largest residual of the matched points', 'm', 1e-5, 0.1)
    max_free_space: float = parameter(0.04, 'largest share of points in seen free space', '', 0.0, 1.0)
    max_outside: float = parameter(0.08, 'largest share of points beside the silhouette', '', 0.0, 1.0)
    max_turn_deg: float = parameter(
        12.0,
        'largest correction of the attitude; only continuity tells symmetric faces apart',
        'deg',
        0.1,
        180.0,
    )
    max_shift: float = parameter(0.03, 'largest correction of the position', 'm', 1e-4, 1.0)


@dataclass(frozen=True)
class Verification:
    """Outcome: the corrected pose, and in words what decided."""

    accepted: bool
    why: str
    T_target_view: Array  # (4, 4), registered; as given where registration failed
    agreement: Agreement


def verify(
    view: View,
    T_target_view: Array,
    reference: View,
    T_target_reference: Array,
    settings: VerificationSettings,
) -> Verification:
    """Register a view to an earlier one and hold the outcome against the bounds.

    Args:
        view: the newer view.
        T_target_view: its pose (4, 4) as odometry has it.
        reference: the earlier view.
        T_target_reference: its pose (4, 4).
        settings: the bounds.
    """
    found = register(view, T_target_view, reference, T_target_reference)
    if found is None:
        return Verification(False, 'the views do not overlap', T_target_view, Agreement())
    T, lin = found
    correction = compose(T, inverse(T_target_view))
    centre = apply(T_target_view, view.centroid)
    turn = np.degrees(rotation_angle(correction[:3, :3]))
    shift = float(np.linalg.norm(apply(correction, centre) - centre))
    a, s = lin.agreement, settings
    checks = [
        ('overlap', a.overlap, '>=', s.min_overlap, a.overlap >= s.min_overlap),
        ('residual_mm', a.rms * 1e3, '<=', s.max_rms * 1e3, a.rms <= s.max_rms),
        ('free_space', a.free_space, '<=', s.max_free_space, a.free_space <= s.max_free_space),
        ('outside', a.outside, '<=', s.max_outside, a.outside <= s.max_outside),
        ('correction_deg', turn, '<=', s.max_turn_deg, turn <= s.max_turn_deg),
        ('correction_mm', shift * 1e3, '<=', s.max_shift * 1e3, shift <= s.max_shift),
    ]
    failed = [
        f'{name} {value:.3g} not {sign} {bound:.3g}' for name, value, sign, bound, good in checks if not good
    ]
    why = '; '.join(failed) or ', '.join(f'{name} {value:.3g}' for name, value, *_ in checks)
    return Verification(not failed, why, T, a)
