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

"""Batch processor: one constant rate fitted to all observations, and the model poses that follow (T7).

Trowbridge 2014, section 2.7, eq. 2.50-2.60, and section 4.1, eq. 4.1-4.3. Weighted least squares about
a reference trajectory, after Tapley, Schutz and Born. State: Euler parameters (scalar first) and body
rate. It has no loop closure and drifts; that is what the thesis shows with it.

The rates are observed alone, so the initial attitude rests on the prior, and the normal equations are
linear: the second iteration only confirms the first. Eq. 2.59 has the derivatives for a spin about y and
sets those for the other two rates to zero; ``planar=False`` fills them in for a spin about any axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, compose, transform
from debris_scanner.research.thesis.euler_parameters import (
    IDENTITY,
    RateObservation,
    left_matrix,
    of_rate,
    rate_jacobian,
    right_matrix,
    rotation_matrix,
)

MIN_FITNESS = 1e-12  # m²: a smaller residual is rounding and must not outweigh everything else
_H = np.hstack([np.zeros((3, 4)), np.eye(3)])  # eq. 2.51


@dataclass(frozen=True)
class BatchResult:
    """Best estimate of the state at the first frame's time and what is left over."""

    start_ns: int
    state: Array  # (7,)
    covariance: Array  # (7, 7), formal
    residuals: Array  # (n, 3) rad/s, post-fit, of the observations that carry a rate
    stamps: list[int]  # of those observations
    iterations: int
    planar: bool

    def attitude(self, stamp_ns: int) -> Array:
        """Rotation R_sensor_target (3, 3) at a time, eq. 2.57; the target frame is the first frame's."""
        t = (stamp_ns - self.start_ns) * 1e-9
        return rotation_matrix(_predicted(self.state, t, self.planar)[:4])


def state_transition(state: Array, t: float, planar: bool = True) -> Array:
    """Derivative (7, 7) of the state after t seconds by the initial one, eq. 2.59."""
    omega = _about_y(state[4:]) if planar else state[4:]
    J = rate_jacobian(omega, t)
    Phi = np.eye(7)
    if planar:
        Phi[:4, 5] = J[:, 1]  # as printed: the attitude's own block stays the identity
    else:
        Phi[:4, :4] = right_matrix(of_rate(omega, t))
        Phi[:4, 4:] = left_matrix(state[:4]) @ J
    return Phi


def estimate(
    start_ns: int,
    observations: Sequence[RateObservation],
    prior_state: Array | None = None,
    prior_covariance: Array | None = None,
    planar: bool = True,
    tolerance: float = 1e-12,
    max_iterations: int = 20,
) -> BatchResult:
    """State at the first frame that fits all rates best, each weighted by 1/d_k (eq. 2.52).

    Args:
        start_ns: stamp of the first frame, before the first observation.
        observations: rates; those that are None are skipped.
        prior_state: (7,), default at rest with the attitude of eq. 2.58 as corrected.
        prior_covariance: (7, 7), default the identity as in Tables 4.1-4.3.
        planar: spin about y only, as eq. 2.57 and 2.59.
        tolerance: largest change of the state that counts as converged.
        max_iterations: upper bound.

    Raises:
        ValueError: if there is no rate at all.
    """
    seen = [(o.stamp_ns, o.omega, o.fitness) for o in observations if o.omega is not None]
    if not seen:
        raise ValueError('a batch without a single angular rate has no solution')
    prior = np.array([*IDENTITY, 0.0, 0.0, 0.0]) if prior_state is None else np.array(prior_state, float)
    P_inverse = np.linalg.inv(np.eye(7) if prior_covariance is None else prior_covariance)
    state = prior.copy()
    iterations = 0
    while iterations < max_iterations:
        iterations += 1
        information = P_inverse.copy()
        right_side = P_inverse @ (prior - state)
        for stamp_ns, omega, fitness in seen:
            t = (stamp_ns - start_ns) * 1e-9
            H = _H @ state_transition(state, t, planar)
            weight = 1.0 / max(fitness, MIN_FITNESS)
            information += weight * H.T @ H
            right_side += weight * H.T @ (omega - _H @ _predicted(state, t, planar))
        step = np.linalg.solve(information, right_side)
        state = state + step
        state[:4] /= np.linalg.norm(state[:4])
        if np.abs(step).max() < tolerance:
            break
    residuals = np.array([omega - state[4:] for _, omega, _ in seen])
    return BatchResult(
        start_ns, state, np.linalg.inv(information), residuals, [s for s, _, _ in seen], iterations, planar
    )


def replace_outliers(
    translations: Array, sigmas: float = 3.0, window: int = 4
) -> tuple[Array, NDArray[np.bool_]]:
    """Translations (n, 3) with outliers interpolated between their neighbours, and which were, (n,) bool.

    Rows of NaN, where nothing was measured, count as outliers; where all are, nothing moves.

    Steps 2 and 3 of section 2.7. The thesis does not say what makes an outlier; here it is a component
    further than ``sigmas`` robust standard deviations from the median of ``window`` frames to either side.
    """
    known = np.isfinite(translations).all(axis=1)
    median = np.array(
        [_median(translations[max(0, k - window) : k + window + 1]) for k in range(len(translations))]
    ).reshape(-1, 3)
    off = np.abs(translations - median)
    sigma = 1.4826 * np.median(off[known], axis=0) if known.any() else np.zeros(3)
    outlier = ~known | np.any(off > sigmas * sigma + 1e-9, axis=1)
    if outlier.all():
        return np.zeros_like(translations), outlier
    index = np.arange(len(translations))
    columns = [np.interp(index, index[~outlier], translations[~outlier, k]) for k in range(3)]
    return np.stack(columns, axis=1), outlier


def odometry_poses(rotations: Sequence[Array], translations: Array) -> list[Array]:
    """Transforms (4, 4) from every frame into the first one, eq. 4.1-4.3.

    Args:
        rotations: (3, 3) from frame n into the first one, of all n frames.
        translations: (n - 1, 3) from frame n into the one before, metres, from ICP, outliers replaced.

    The translations belong to ICP's rotations about the sensor; combined with rotations from elsewhere
    they shift the target by its distance times the difference of the two, every frame.
    """
    poses = [np.eye(4)]
    for k, t in enumerate(translations, start=1):
        R_previous_current = rotations[k - 1].T @ rotations[k]
        poses.append(compose(poses[-1], transform(R_previous_current, t)))
    return poses


def _about_y(omega: Array) -> Array:
    return np.array([0.0, omega[1], 0.0])


def _predicted(state: Array, t: float, planar: bool) -> Array:
    """State (7,) after t seconds at constant rate, eq. 2.57."""
    omega = state[4:]
    if planar:
        return np.concatenate([of_rate(_about_y(omega), t), omega])
    return np.concatenate([left_matrix(state[:4]) @ of_rate(omega, t), omega])


def _median(window: Array) -> Array:
    known = window[np.isfinite(window).all(axis=1)]
    return np.median(known, axis=0) if len(known) else np.full(3, np.nan)
