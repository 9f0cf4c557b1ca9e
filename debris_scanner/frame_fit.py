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

"""One frame fitted: the filter's iterated update with the registration as its measurement."""

from dataclasses import dataclass

import numpy as np

from debris_scanner.geometry import Array, inverse
from debris_scanner.motion_filter import ATTITUDE, CENTRE, SIZE, MotionFilter
from debris_scanner.observability import rotation_observability
from debris_scanner.registration import Agreement, linearise, linearise_pair
from debris_scanner.views import Surface, View

Reference = tuple[Surface, Array]  # a view or the model, with its pose in the target frame

GOOD_RMS = 0.0021  # m: residuals up to here say nothing against a fit


@dataclass
class FrameFit:
    """The updated filter, and how the frame agrees with the reference it agrees with best."""

    filter: MotionFilter
    agreement: Agreement
    observability: float
    overlap: float  # share of what should match and does
    explained: float  # the same of what the reference shows at all: it may be the smaller part
    missing: float  # largest share of a whole reference that lies beside the frame's silhouette
    witnessed: bool = False  # one of the references was whole: what is hidden would be missed

    @property
    def score(self) -> float:
        """To compare fits of one frame: overlap less all contradictions."""
        a = self.agreement
        beside = a.outside + self.missing
        return self.overlap - 2 * a.free_space - 0.5 * beside - 100 * max(0.0, a.rms - GOOD_RMS)


def fit_frame(
    prior: MotionFilter,
    view: View,
    references: list[Reference],
    gates: tuple[float, ...],
    start: MotionFilter | None = None,
) -> FrameFit:
    """Register a view to all references at once, inside the filter.

    Args:
        prior: the predicted filter; left as it is.
        view: the frame.
        references: at least one.
        gates: largest point-to-plane distance of a match in each iteration, metres.
        start: where the iterations begin; None: at the prior.
    """
    motion = (start or prior).copy()
    information = np.asarray(np.linalg.inv(prior.P + 1e-14 * np.eye(SIZE)), np.float64)
    for gate in gates:
        T_target_view = inverse(motion.T_sensor_target)
        H, g = np.zeros((6, 6)), np.zeros(6)
        for surface, pose in references:
            Hr, gr = _measure(view, T_target_view, surface, pose, gate)
            H += Hr / len(references)
            g += gr / len(references)
        step = motion.update_step(prior, information, H, g)
        settled = np.linalg.norm(step[ATTITUDE]) < 1e-4 and np.linalg.norm(step[CENTRE]) < 3e-5
        if settled and gate == gates[-1]:
            break
    return _judge(motion, view, references, gates[-1])


def _judge(motion: MotionFilter, view: View, references: list[Reference], gate: float) -> FrameFit:
    T_target_view = inverse(motion.T_sensor_target)
    best: FrameFit | None = None
    missing: list[float] = []
    for surface, pose in references:
        lin = reverse = linearise(surface, pose, view, T_target_view, gate)
        overlap = explained = reverse.agreement.explained
        if surface.whole:  # of a half hidden one, what the same shadow hides is not missing
            missing.append(reverse.agreement.outside)
        if isinstance(surface, View):
            lin = linearise(view, T_target_view, surface, pose, gate)
            if not surface.whole:
                lin.agreement = lin.agreement.within_silhouette()
            overlap, explained = lin.agreement.overlap, lin.agreement.explained
        if best is None or overlap > best.overlap:
            seen = rotation_observability(lin.H, lin.agreement.matched, view, T_target_view)
            best = FrameFit(motion, lin.agreement, seen, overlap, explained, reverse.agreement.outside)
    assert best is not None
    best.missing, best.witnessed = max(missing, default=best.missing), bool(missing)
    return best


def _measure(
    view: View, T_target_view: Array, surface: Surface, pose: Array, gate: float
) -> tuple[Array, Array]:
    """Normal equations for a twist of the view, against another view or the model."""
    if isinstance(surface, View):
        lin = linearise_pair(view, T_target_view, surface, pose, gate)
        return lin.H, lin.g
    lin = linearise(surface, pose, view, T_target_view, gate)
    return lin.H, -lin.g
