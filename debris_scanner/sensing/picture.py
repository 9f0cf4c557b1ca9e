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

"""The picture of a target: what paint, print or markings show beside the depth, ready for registration.

A lamp that stays where it is lights a turning target anew in each frame, and shading and highlights do not
turn along. What it multiplies all colours by is no evidence, so two channels of a picture are ratios of
colours, as logarithms: red to green, and both to blue. A colour camera's white balance is an offset that two
views need not share. The third is brightness without what the lamp explains (`unshade`), above its
surroundings: all that infrared, amplitude or black and white paint have.

They are smoothed to the distance of the points that are registered, and a second level is four times as
coarse, for views that are still far apart. Pixels without depth, black ones and saturated ones say nothing,
and neither do those at the silhouette, where the background's light mixes in.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel

Image = NDArray[np.float32]

COARSE = 4  # pixels of the image, along either side of one of the coarse level
DARK = 0.1  # of the target's mean brightness: colours of what is darker are noise
SATURATED = 255
CHANNELS = 3  # two ratios of colours, and brightness
LIGHT = 2
# of logarithms: to equal noise
ACROSS, BELOW, ALL = np.float32(0.5**0.5), np.float32(1.5**-0.5), np.float32(3**-0.5)
KNOWN = 10.0  # the value of equal colours: that of an unknown pixel is 0
BLUR = 0.5  # standard deviation, of the distance of the sampled points
LEAST_KNOWN = 0.8  # share of a pixel's surroundings that is target
FEWEST = 200  # pixels of a picture
NOTHING = 1e-3  # of a logarithm: what rounding makes of equal values
AROUND = 7.0  # brightness is that above a square around it, so many smoothings to either side
# directions of the surface that one lamp lights alike: at most so many cells along an axis, of so many pixels
MOST_CELLS, CELL_PIXELS = 32, 40.0
MOST_LACKING = 0.05  # share of a direction's points
EVERY = 2  # rows and columns that show how light falls
UNSHADE_ROUNDS, MEAN_TO_FAR = 4, 2.0  # of the robust mean, whose outliers are so many mean deviations off

_kernel = kernel(fastmath=True)


@dataclass
class Level:
    """A picture at one scale.

    A pixel (u, v) of the window is ((u + 0.5) / scale - 0.5, (v + 0.5) / scale - 0.5) here.
    """

    scale: float
    values: Image  # (h, w, CHANNELS), logarithms about KNOWN; 0 where nothing is known
    shown: Image  # (n, CHANNELS), the same of the view's points


class Picture:
    """The picture of a view at two scales, each made when it is asked for.

    Args:
        frame: a target frame with colours.
        stride: px, distance of the points that are sampled.
        points: (n, 3), m, of the view, in the sensor's frame.
    """

    def __init__(self, frame: TargetFrame, stride: int, points: Image) -> None:
        self._frame, self._stride, self._points = frame, stride, points
        self._levels: dict[bool, Level | None] = {}
        self._whole: Picture | None = None  # that this one has every so many points of
        self._step = 1

    def level(self, coarse: bool) -> Level | None:
        """One of the scales; None where the frame shows no colours, but black, white and grey."""
        if coarse not in self._levels:
            self._levels[coarse] = (
                self._made(coarse) if self._whole is None else self._some(self._whole.level(coarse))
            )
        return self._levels[coarse]

    def thinned(self, step: int) -> 'Picture':
        """The same, of every step-th point."""
        thin = copy(self)
        thin._levels, thin._whole, thin._step = {}, self, step
        return thin

    def _some(self, level: Level | None) -> Level | None:
        return level and replace(level, shown=np.ascontiguousarray(level.shown[:: self._step]))

    def _made(self, coarse: bool) -> Level | None:
        channels = self._channels
        if channels is None:
            return None
        scale, sigma = (float(COARSE), 1.0) if coarse else (1.0, BLUR * self._stride)
        values = _smoothed(_binned(channels, COARSE) if coarse else channels, _gaussian(sigma), LEAST_KNOWN)
        if len(channels) < CHANNELS:  # grey
            ratios = np.where(values > 0, np.float32(KNOWN), np.float32(0))
            values = np.concatenate([ratios, ratios, values], axis=2)
        _level(values, round(AROUND * sigma))
        c = self._frame.camera
        shown = _looked_up(self._points, np.array([c.fx, c.fy, c.cx, c.cy]), values, scale)
        return Level(scale, values, shown)

    @cached_property
    def _channels(self) -> Image | None:
        frame = self._frame
        # a copy: what is stored is read-only, and a kernel would be compiled for that once more
        channels = logarithms(np.array(frame.rgb, order='C'), frame.depth)
        unshade(channels[LIGHT], frame.depth_fit, frame.normals)
        if not _shows_something(channels):
            return None
        return channels if _has_colours(channels) else np.ascontiguousarray(channels[LIGHT:])


@_kernel
def _looked_up(points: Image, intrinsics: Array, values: Image, scale: float) -> Image:
    """Interpolated values (n, CHANNELS) where points (n, 3) are; 0 where one of four pixels is unknown."""
    fx, fy, cx, cy = intrinsics
    h, w, channels = values.shape
    out = np.zeros((len(points), channels), np.float32)
    one = np.float32(1)
    for k in range(len(points)):
        z = points[k, 2]
        column = (points[k, 0] / z * fx + cx + 0.5) / scale - 0.5
        row = (points[k, 1] / z * fy + cy + 0.5) / scale - 0.5
        u, v = int(np.floor(column)), int(np.floor(row))
        if u < 0 or v < 0 or u >= w - 1 or v >= h - 1:
            continue
        a, b = np.float32(column - u), np.float32(row - v)
        for c in range(channels):
            p, q, r, s = values[v, u, c], values[v, u + 1, c], values[v + 1, u, c], values[v + 1, u + 1, c]
            if min(p, q, r, s) > 0:
                out[k, c] = (one - b) * ((one - a) * p + a * q) + b * ((one - a) * r + a * s)
    return out


@_kernel
def logarithms(rgb: NDArray[np.uint8], depth: Image) -> Image:
    """Two logarithms of ratios and that of brightness (CHANNELS, h, w) of a picture (h, w, 3), about KNOWN.

    Their noise is equal and unrelated. They are 0 off the target, and where a picture is black or saturated.
    """
    h, w = depth.shape
    out = np.zeros((CHANNELS, h, w), np.float32)
    total, count = 0.0, 0
    for v in range(h):
        for u in range(w):
            if depth[v, u] > 0:
                total += max(rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2])
                count += 1
    dark = np.float32(DARK * total / max(1, count))
    bright = np.log(np.float32(total / max(1, count)) + dark)
    steps = np.log(np.arange(SATURATED + 1).astype(np.float32) + dark)
    for v in range(h):
        for u in range(w):
            r, g, b = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            if depth[v, u] > 0 and 0 < max(r, g, b) < SATURATED:
                red, green, blue = steps[r], steps[g], steps[b]
                out[0, v, u] = np.float32(KNOWN) + ACROSS * (red - green)
                out[1, v, u] = np.float32(KNOWN) + BELOW * (np.float32(0.5) * (red + green) - blue)
                out[2, v, u] = np.float32(KNOWN) + ALL * (red + green + blue - np.float32(3) * bright)
    return out


@_kernel
def _shows_something(values: Image) -> bool:
    """Whether enough pixels of values (CHANNELS, h, w) are known, and one of them is not like all others."""
    known, shown = 0, False
    for v in range(values.shape[1]):
        for u in range(values.shape[2]):
            if values[0, v, u] > 0:
                known += 1
                for c in range(CHANNELS):
                    shown = shown or abs(values[c, v, u] - np.float32(KNOWN)) > NOTHING
        if shown and known >= FEWEST:
            return True
    return False


@_kernel
def _has_colours(values: Image) -> bool:
    """Whether a known pixel of values (CHANNELS, h, w) is not grey."""
    for c in range(LIGHT):
        for v in range(values.shape[1]):
            for u in range(values.shape[2]):
                if values[c, v, u] > 0 and values[c, v, u] != np.float32(KNOWN):
                    return True
    return False


@_kernel
def unshade(light: Image, fitted: Image, normals: Image) -> None:
    """Take out of brightness what the direction of the surface explains: shade and highlights.

    A far lamp lights all points alike that face the same way, whatever their place. So the robust mean of
    brightness over all points whose normals fall into one cell is light, and the rest is paint. The cells
    shrink with the number of points; in between their means are interpolated. Where part of a direction's
    points are saturated or black the mean of the others is not its light, and none of them says anything.

    Args:
        light: logarithm of brightness (h, w) about KNOWN, 0 where unknown; afterwards about the light, and
            KNOWN where that is unknown, as where no plane fits.
        fitted: depth (h, w) on the fitted planes, 0 where there is none.
        normals: (h, w, 3), unit.
    """
    h, w = light.shape
    points = 0
    for v in range(0, h, EVERY):
        for u in range(0, w, EVERY):
            points += light[v, u] > 0 and fitted[v, u] > 0
    cells = int(min(MOST_CELLS, max(1.0, (points * EVERY * EVERY / CELL_PIXELS) ** 0.5)))
    mean, total, count, lacking = np.zeros((4, cells + 2, cells + 2), np.float32)
    spread, half = np.float32(0), np.float32(0.5 * cells)
    one, known = np.float32(1), np.float32(KNOWN)
    for turn in range(UNSHADE_ROUNDS + 1):  # the last applies the means
        last = turn == UNSHADE_ROUNDS
        every = 1 if last else EVERY
        total[:], count[:] = 0, 0
        off, n = np.float32(0), 0
        for v in range(0, h, every):
            for u in range(0, w, every):
                if fitted[v, u] <= 0:
                    if last and light[v, u] > 0:
                        light[v, u] = known
                    continue
                x, y = (normals[v, u, 0] + one) * half, (normals[v, u, 1] + one) * half
                i, j = int(x), int(y)
                a, b = x - np.float32(i), y - np.float32(j)
                w0, w1, w2, w3 = (one - a) * (one - b), (one - a) * b, a * (one - b), a * b
                if light[v, u] <= 0:
                    if turn == 0:
                        for row, column, share in (
                            (i, j, w0),
                            (i, j + 1, w1),
                            (i + 1, j, w2),
                            (i + 1, j + 1, w3),
                        ):
                            lacking[row, column] += share
                    continue
                left = light[v, u] - (
                    w0 * mean[i, j] + w1 * mean[i, j + 1] + w2 * mean[i + 1, j] + w3 * mean[i + 1, j + 1]
                )
                if last:
                    lack = (
                        w0 * lacking[i, j] + w1 * lacking[i, j + 1]
                        + w2 * lacking[i + 1, j] + w3 * lacking[i + 1, j + 1]
                    )  # fmt: skip
                    light[v, u] = left if lack < MOST_LACKING else known
                    continue
                left -= known
                off, n = off + abs(left), n + 1
                trust = one
                if turn > 1:
                    trust = one / (one + (left / spread) ** 2) ** 2
                value = trust * (light[v, u] - known)
                for row, column, share in ((i, j, w0), (i, j + 1, w1), (i + 1, j, w2), (i + 1, j + 1, w3)):
                    total[row, column] += share * value
                    count[row, column] += share * trust
        spread = np.float32(MEAN_TO_FAR) * off / np.float32(max(1, n)) + np.float32(1e-6)
        mean[:] = total / (count + np.float32(1e-9))
        if turn == 0:
            lacking = (lacking + np.float32(1e-9)) / (count + lacking + np.float32(1e-9))


@_kernel
def _level(values: Image, reach: int) -> None:
    """Take the mean brightness of a square around it off that of each pixel of values (h, w, CHANNELS)."""
    h, w, _ = values.shape
    total, count = np.zeros((h + 1, w + 1)), np.zeros((h + 1, w + 1), np.int32)
    for v in range(h):
        along, known = 0.0, 0
        for u in range(w):
            if values[v, u, LIGHT] > 0:
                along, known = along + values[v, u, LIGHT], known + 1
            total[v + 1, u + 1], count[v + 1, u + 1] = total[v, u + 1] + along, count[v, u + 1] + known
    for v in range(h):
        top, bottom = max(0, v - reach), min(h, v + reach + 1)
        for u in range(w):
            if values[v, u, LIGHT] > 0:
                left, right = max(0, u - reach), min(w, u + reach + 1)
                around = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
                n = count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left]
                values[v, u, LIGHT] += np.float32(KNOWN - around / n)


@_kernel
def _binned(values: Image, size: int) -> Image:
    """Mean (c, h, w) of what is known in each square of pixels; 0 where that is less than half of it."""
    channels, h, w = values.shape[0], values.shape[1] // size, values.shape[2] // size
    out = np.zeros((channels, h, w), np.float32)
    line, known = np.empty(w * size, np.float32), np.empty(w * size, np.float32)
    for v in range(h):
        known[:] = 0
        for b in range(v * size, (v + 1) * size):
            for u in range(w * size):  # known alike in all
                known[u] += np.float32(values[0, b, u] > 0)
        for c in range(channels):
            line[:] = 0
            for b in range(v * size, (v + 1) * size):
                for u in range(w * size):
                    line[u] += values[c, b, u]
            for u in range(w):
                count = known[u * size : (u + 1) * size].sum()
                if 2 * count > size * size:
                    out[c, v, u] = line[u * size : (u + 1) * size].sum() / count
    return out


def _gaussian(sigma: float) -> Image:
    """Weights (n,) by distance in pixels, 0 and up."""
    reach = max(1, round(2 * sigma))
    weights = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    return np.asarray(weights / (2 * weights.sum() - weights[0]), np.float32)


@_kernel
def _smoothed(values: Image, weights: Image, least: float) -> Image:
    """Images (c, h, w), known alike, smoothed by weights (n,), as (h, w, c); 0 where less is known."""
    channels, h, w = values.shape
    reach = len(weights) - 1
    known = np.empty((h, w), np.float32)
    for v in range(h):
        for u in range(w):
            known[v, u] = np.float32(values[0, v, u] > 0)
    share = _convolved(known, weights, reach)
    for v in range(h):
        for u in range(w):
            enough = known[v, u] > 0 and share[v, u] > least
            share[v, u] = np.float32(1) / share[v, u] if enough else np.float32(0)
    out = np.empty((h, w, channels), np.float32)
    for c in range(channels):
        total = _convolved(values[c], weights, reach)
        for v in range(h):
            for u in range(w):
                out[v, u, c] = total[v, u] * share[v, u]
    return out


@_kernel
def _convolved(image: Image, weights: Image, reach: int) -> Image:
    """An image (h, w), 0 beyond, under symmetric weights along rows and columns."""
    h, w = image.shape
    out = np.zeros((h, w), np.float32)
    line = np.zeros(w + 2 * reach, np.float32)
    for v in range(h):
        row = line[reach : reach + w]
        row[:] = 0
        for b in range(max(0, v - reach), min(h, v + reach + 1)):
            weight = weights[abs(b - v)]
            for u in range(w):
                row[u] += weight * image[b, u]
        for k in range(2 * reach + 1):
            weight = weights[abs(k - reach)]
            for u in range(w):
                out[v, u] += weight * line[u + k]
    return out
