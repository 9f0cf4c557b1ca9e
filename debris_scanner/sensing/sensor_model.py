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

"""The sensor's noise, measured on its own stream: two registered views of one surface differ by nothing else.

The points of one view are compared with the depth that the other measured there. Their differences have twice
the variance of a single depth. Planes fitted within one view would tell less: noise that neighbouring pixels
share looks like shape there. What stays in place in the image shows in neither: that is
:mod:`debris_scanner.mapping.self_calibration`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.sensing.views import FACING_COS, MAD_TO_SIGMA, USUAL_NOISE, View

OBLIQUE_COS = 0.4  # between here and facing, 50 to 66 degrees from the normal
REACH = 8.0  # px in depth: points further off are hidden, or not the target
LAGS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)  # px
CLIP = 4.0  # sigma, of residuals that are correlated
FEWEST = 200  # residuals; fewer tell nothing

TYPICAL_SHARES = ((0.93, 0.02, 0.02, 0.03), (0.8, 0.05, 0.05, 0.1))

Pair = tuple[View, Array, View]  # a view, T_other_view (4, 4) as registered, the other view


@dataclass(frozen=True)
class SensorModel:
    """Noise of a depth sensor at the target."""

    range_m: float  # median depth of the target
    footprint_m: float  # of a pixel there
    sigma_m: float  # of a pixel's depth, on surfaces that face the sensor
    sigma_oblique_m: float | None  # on those seen at 50 to 66 degrees; None where there were few
    correlation_px: float  # lag at which the noise's correlation has fallen to 1/e
    pairs: int  # of views it was measured on
    # of what a pixel returns of facing and of oblique surface: hit, short, long, none
    shares: tuple[tuple[float, ...], ...] = TYPICAL_SHARES
    offset_m: float = 0.0  # RMS of an error that stays in the image; 0 where none shows
    offset_px: float = 0.0  # and the lag at which its correlation has fallen to 1/e

    def in_brief(self) -> dict[str, float]:
        """The figures by name and unit, for the diagnostics."""
        return {
            'range_m': round(self.range_m, 3),
            'footprint_mm': round(1e3 * self.footprint_m, 3),
            'noise_mm': round(1e3 * self.sigma_m, 3),
            'correlation_px': round(self.correlation_px, 2),
            'offset_mm': round(1e3 * self.offset_m, 3),
            'pairs': self.pairs,
        }


def typical_sensor(views: Sequence[View]) -> SensorModel:
    """What is assumed of a sensor until its noise can be measured: it grows with a pixel's footprint."""
    footprint = float(np.median([v.footprint for v in views]))
    range_m = float(np.median([v.footprint * v.frame.camera.focal for v in views]))
    return SensorModel(range_m, footprint, USUAL_NOISE * footprint, None, 0.0, 0)


def measure_sensor(pairs: Sequence[Pair]) -> SensorModel | None:
    """The noise that registered pairs of views show; None if they have too little in common."""
    maps = [difference(*pair) for pair in pairs]
    residual = np.concatenate([r[seen] for r, _, seen in maps]) if maps else np.zeros(0)
    cosine = np.concatenate([c[seen] for _, c, seen in maps]) if maps else np.zeros(0)
    facing = residual[cosine > FACING_COS]
    if len(facing) < FEWEST:
        return None
    oblique = residual[(cosine > OBLIQUE_COS) & (cosine <= FACING_COS)]
    views = [view for view, _, _ in pairs]
    return SensorModel(
        range_m=float(np.median([v.footprint * v.frame.camera.focal for v in views])),
        footprint_m=float(np.median([v.footprint for v in views])),
        sigma_m=_sigma(facing) / np.sqrt(2),
        sigma_oblique_m=_sigma(oblique) / np.sqrt(2) if len(oblique) >= FEWEST else None,
        correlation_px=_correlation_length([(r, seen) for r, _, seen in maps]),
        pairs=len(pairs),
    )


def difference(
    view: View, T_other_view: Array, other: View, reach: float = REACH
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Depth of a view's pixels less what another view measured there, m; incidence; where both are known.

    Args:
        view: whose pixels are compared.
        T_other_view: (4, 4).
        other: what they are compared with.
        reach: px in depth; what lies further off is not compared.

    Returns:
        Each (h, w), of the view's window.
    """
    frame, seen_by = view.frame, other.frame
    c, d = frame.camera, seen_by.camera
    shape = frame.depth.shape
    residual, cosine, seen = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.bool_)
    v, u = np.nonzero((frame.depth > 0) & (frame.depth_fit > 0))
    z = frame.depth[v, u].astype(np.float64)
    p = np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], axis=1)
    p = p @ T_other_view[:3, :3].T + T_other_view[:3, 3]
    a = np.rint(p[:, 0] / p[:, 2] * d.fx + d.cx).astype(int)
    b = np.rint(p[:, 1] / p[:, 2] * d.fy + d.cy).astype(int)
    h, w = seen_by.depth.shape
    k = np.flatnonzero((a >= 0) & (b >= 0) & (a < w) & (b < h) & (p[:, 2] > 0))
    q, n = seen_by.depth[b[k], a[k]].astype(np.float64), seen_by.normals[b[k], a[k]].astype(np.float64)
    ray = np.stack([(a[k] - d.cx) / d.fx, (b[k] - d.cy) / d.fy, np.ones(len(k))], axis=1)
    slope = (n * ray).sum(axis=1)  # negative where the surface faces the sensor
    known = (q > 0) & (slope < 0)
    k, q, n, ray, slope = k[known], q[known], n[known], ray[known], slope[known]
    # along the ray, so that the rounding to a pixel does not count
    off = (n * (p[k] - ray * q[:, None])).sum(axis=1) / slope
    near = np.abs(off) < reach * other.resolution
    k, off = k[near], off[near]
    residual[v[k], u[k]], seen[v[k], u[k]] = off, True
    cosine[v[k], u[k]] = -slope[near] / np.linalg.norm(ray[near], axis=1)
    return residual, cosine, seen


def _sigma(residuals: NDArray[np.float64]) -> float:
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals - np.median(residuals))))


def _correlation_length(maps: Sequence[tuple[NDArray[np.float64], NDArray[np.bool_]]]) -> float:
    """Lag, px, at which the correlation of residual maps falls to 1/e, along rows and columns."""
    before = 1.0
    total = np.zeros(len(LAGS) + 1)
    count = np.zeros(len(LAGS) + 1)
    for residual, seen in maps:
        sigma = _sigma(residual[seen]) if seen.any() else 0.0
        if sigma <= 0:
            continue
        e = np.where(seen, np.clip(residual / sigma, -CLIP, CLIP), 0.0)
        for n, lag in enumerate((0, *LAGS)):
            for x, s in ((e, seen), (e.T, seen.T)):
                total[n] += float((x[:, lag:] * x[:, : x.shape[1] - lag]).sum())
                count[n] += np.count_nonzero(s[:, lag:] & s[:, : s.shape[1] - lag])
    if not count.all() or total[0] <= 0:
        return 0.0
    correlation = (total / count) / (total[0] / count[0])
    for n, lag in enumerate(LAGS, start=1):
        if correlation[n] < np.exp(-1):
            # between this lag and the one before
            earlier = LAGS[n - 2] if n > 1 else 0
            share = (before - np.exp(-1)) / (before - correlation[n])
            return float(earlier + share * (lag - earlier))
        before = float(correlation[n])
    return float(LAGS[-1])
