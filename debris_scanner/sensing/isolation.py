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

"""Target isolation: the pixels of a depth image that show the target.

1. The pass-through box marks the pixels that are looked at. It is thesis part T2 (Trowbridge 2014, section
   3.2).
2. `StillDepth` marks pixels that show something that stands still. A rotating target changes the depth under
   nearly every pixel it covers within a second; a wall, a table or a mug beside it does not.
3. A coarse grid groups the points into clusters. Its cells are some pixels wide and as deep as they are wide,
   so they grow with the distance and suit a target of any size. The target is the largest cluster, or, once
   there is one, the cluster that continues it, with the parts that lie apart from it: a panel behind the
   body, say. Clusters that stand still or reach out of the box are clutter as long as there is something
   else.

A target that was found stands alone in its surroundings, mostly: then nothing else in the image decides what
belongs to it, and only these surroundings are looked at. The whole image is looked at every few frames, for
what comes in, and whenever something not known to stand still lies around the target.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import FrameRejected
from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import inlined, kernel
from debris_scanner.core.parameters import ParameterError, parameter
from debris_scanner.sensing.still_depth import (
    IN_BOX,
    LEAST_TOLERANCE,
    MOVED,
    STILL,
    Marks,
    Region,
    StillDepth,
    still_tolerance,
    tolerance,
)
from debris_scanner.sensing.support import SupportPlanes

SETTLING_S = 1.3  # until still clusters are confirmed as such
SETTLING = 'settling'  # reason of frames before that
TOUCHED = 'touched'  # reason of frames in which the target is one with something that reaches in

STILL_SHARE = 0.7  # of a cluster's pixels, for it to stand still, or to have moved
CUT_SHARE = 0.02  # of a cluster's pixels at the faces of the box or the image's edge, for it to reach out
CUT_LENGTH = 1 / 3  # or the length, of its extent, that it has along the image's edge
BORDER = 10.0  # px: a point this near to a face of the box lies at it
BORDER_PX = 3  # likewise at the image's edge
LEAST_RANGE, MOST_RANGE = 0.05, 40.0  # m, of the grid
MOST_FOCAL = 4000.0  # px; a longer one, of a damaged camera_info, makes no finer grid
SPECK = 0.5  # of the smallest target: a part that is smaller is noise
LONGEST_TOUCH_NS = 10 * 10**9  # after that it is the target that has come nearer
MAX_GROWTH = 1.5  # a target is at most this much larger than it ever was
GROWN = 2  # cells by which those of the target are grown: it moves
WHOLE_EVERY = 5  # frames, of which one is looked at as a whole
MARGIN_CELLS = 1  # by which a target moves from frame to frame, mostly
JOINED_CELLS = 2  # no points that lie further apart are of one cluster


@dataclass(frozen=True)
class IsolationSettings:
    """Where to look for the target, in the sensor's optical frame."""

    box_min: tuple[float, float, float] = parameter(
        (-20.0, -20.0, 0.1), 'lower corner of the pass-through box', 'm'
    )
    box_max: tuple[float, float, float] = parameter(
        (20.0, 20.0, 20.0), 'upper corner of the pass-through box', 'm'
    )
    cluster_gap: float = parameter(16.0, 'parts of one target are at most so far apart', 'px', 2.0, 200.0)
    part_gap: float = parameter(
        0.4,
        'moving parts are at most so far apart, of its extent',
        '',
        0.0,
        10.0,
    )
    min_pixels: int = parameter(80, 'a smaller target is not tracked', 'px', 20, 10**6)

    def check(self) -> None:
        """Check that the box is none turned inside out.

        Raises:
            ParameterError: it is.
        """
        for axis, low, high in zip('xyz', self.box_min, self.box_max, strict=True):
            if low >= high:
                raise ParameterError(
                    f'isolation.box_min must lie below isolation.box_max: {axis} {low:g} and {high:g} m'
                )

    @property
    def min_part_pixels(self) -> float:
        """A smaller part is a speck."""
        return SPECK * self.min_pixels


@dataclass(frozen=True)
class _Clusters:
    """The labels of cells; per label (0 is none) its size and its marks of clutter."""

    grid: NDArray[np.int32]  # labels of the cells, of the block that holds all points
    corner: NDArray[np.int32]  # (3,), where that block lies in the whole grid
    extents: NDArray[np.float64]  # px, largest of width and height
    sizes: NDArray[np.intp]  # pixels
    still: NDArray[np.bool_]  # it stands still
    moved: NDArray[np.bool_]  # it shows other depths than before
    cut: NDArray[np.bool_]  # it reaches out of the box or the image
    outside: NDArray[np.intp]  # pixels at the edge of the image


class InBox(NamedTuple):
    """The pixels in the box: how many, where, and from which depth to which, metres."""

    pixels: int
    region: Region
    nearest: float
    farthest: float


class TargetIsolator:
    """Finds the target's pixels frame by frame; keeps where it was last seen and what stands still."""

    def __init__(self, settings: IsolationSettings) -> None:
        self.settings = settings
        self._still = StillDepth()
        self._support = SupportPlanes()
        self._support_known = False
        self._camera: Camera | None = None  # its pixels and depths make up the grid
        self._last: tuple[NDArray[np.int32], NDArray[np.bool_]] | None = None  # the target's cells, grown
        self._most = 0  # most pixels it ever had
        self._seen_ns = 0  # when it was last told from the rest
        self.region: Region | None = None  # the box of its pixels in the latest image; None without it
        self._looks = 0  # at the target's surroundings alone, since the whole image was looked at
        self.found = self.cut = 0  # frames with a target, and those in which it reaches out of the view
        self.still_pixels = 0  # left out of the latest frame because they stand still
        self._marks, self._cells = np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.int32)  # (h, w)

    def mask(
        self, depth: NDArray[np.float32], camera: Camera, stamp_ns: int, learn: bool = True
    ) -> NDArray[np.bool_]:
        """Pixels (h, w) of a depth image (metres) that show the target.

        Without ``learn`` the image is an earlier one: what stands still is taken as it is known by now, and
        nothing is waited for.

        Raises:
            FrameRejected: ``no_target`` if the box holds too few points, or nothing but clutter;
                ``touched`` while a hand, or what else reaches in from outside, touches the target;
                ``settling`` while it is undecided which of several clusters stands still.
        """
        s = self.settings
        surroundings = self._surroundings(depth, camera) if learn else None
        self._looks, self.region = 0 if surroundings is None else self._looks + 1, None
        if self._marks.shape != depth.shape:
            self._marks, self._cells = np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.int32)
        whole = (0, depth.shape[0], 0, depth.shape[1])
        box = np.array([s.box_min, s.box_max])
        seen = mark_box(depth, camera, box, surroundings or whole, self._marks)
        if seen.pixels < s.min_pixels:
            raise FrameRejected('no_target', f'{seen.pixels} pixels in the box')
        if learn:
            self._still.observe(camera, stamp_ns, depth, self._marks, surroundings)
            self._learn_support(depth, camera, seen.region)
        else:
            self._still.recall(camera, depth, self._marks)
        clusters, held = self._clusters(depth, camera, seen, box)
        if seen.pixels - held < s.min_pixels:
            left = f'{seen.pixels - held} pixels in the box beside what it stands on'
            raise FrameRejected('no_target', left)
        main = self._continuing(clusters)
        if main is None:
            main = self._first(clusters, settled=not learn or self._is_settled(clusters))
        if self._is_touched(clusters, main, stamp_ns):
            raise FrameRejected(TOUCHED, 'something that reaches in from outside touches the target')
        self.found += 1
        self.cut += int(clusters.cut[main])
        chosen = np.zeros(len(clusters.sizes), np.bool_)
        chosen[[main, *self._parts(clusters, main)]] = True
        if surroundings is None:
            left_out = clusters.still & (clusters.sizes >= s.min_part_pixels) & ~chosen
            left_out[0] = False
            self.still_pixels = int(clusters.sizes[left_out].sum()) + held
        self._remember(clusters, chosen, stamp_ns)
        mask = np.zeros(depth.shape, np.bool_)
        self.region = _mark(self._cells, np.array(seen.region), chosen[clusters.grid.ravel()], mask)
        return mask

    def _surroundings(self, depth: NDArray[np.float32], camera: Camera) -> Region | None:
        """Where the target is by now, if that is enough to look at."""
        known = self._camera is not None and camera.resembles(self._camera)
        settled = self._support_known and self._still.observed_s >= SETTLING_S
        if self.region is None or not (known and settled) or self._looks + 1 >= WHOLE_EVERY:
            return None
        inner, outer = (
            _grown(self.region, round(cells * self.settings.cluster_gap), camera)
            for cells in (MARGIN_CELLS, MARGIN_CELLS + JOINED_CELLS)
        )
        if outer[0] == 0 or outer[2] == 0 or outer[1] == camera.height or outer[3] == camera.width:
            return None
        low, high = self.settings.box_min[2], self.settings.box_max[2]
        around = self._still.unsettled_between(depth, camera, inner, outer, low, high)
        return inner if around < self.settings.min_part_pixels else None

    def _learn_support(self, image: NDArray[np.float32], camera: Camera, region: Region) -> None:
        """Find, once it is settled what stands still, the planes that do and reach out of sight."""
        if self._support_known or self._still.observed_s < SETTLING_S:
            return
        self._support_known = True
        v, u = np.nonzero(self._marks[region[0] : region[1], region[2] : region[3]])
        v, u = v + region[0], u + region[2]
        z = image[v, u].astype(float)
        points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
        depth = self._still.lasting(v, u)
        # what lies behind what has lasted shows that it did not
        known = (depth > 0) & (points[:, 2] < depth + still_tolerance(depth, camera.focal))
        points, v, u, depth = points[known], v[known], u[known], depth[known]
        behind = points * (depth / points[:, 2])[:, None]
        out = _at_edge(v, u, camera) | self._at_face(behind, camera.focal)
        least = CUT_LENGTH * BORDER_PX * min(camera.width, camera.height)
        tolerance = still_tolerance(depth, camera.focal)
        self._support.learn(behind, points, tolerance, out, least, self.settings.min_part_pixels)

    @contextlib.contextmanager
    def looking_back(self) -> Iterator[None]:
        """Look at earlier images, the latest first; then the target is again where it was seen last."""
        before = self._last, self._seen_ns, self.region
        try:
            yield
        finally:
            self._last, self._seen_ns, self.region = before

    def _clusters(
        self, depth: NDArray[np.float32], camera: Camera, seen: InBox, box: Array
    ) -> tuple[_Clusters, int]:
        """Clusters of the marked pixels, and how many pixels lie in what the target stands on."""
        gap = self.settings.cluster_gap
        if self._camera is None or not camera.resembles(self._camera):
            self._camera, self._last = camera, None
        focal = min(self._camera.focal, MOST_FOCAL)
        region = np.array(seen.region)
        corner, shape = _block(region, seen.nearest, seen.farthest, gap, focal / gap)
        counts = np.zeros((int(shape.prod()), 5), np.int32)
        held = _gather(
            depth, np.array([camera.fx, camera.fy, camera.cx, camera.cy]), self._marks, region,
            self._support.uneven_planes, LEAST_TOLERANCE / camera.focal, box, BORDER / focal, gap,
            focal / gap, corner, shape, self._cells, counts,
        )  # fmt: skip
        grid, labels = scipy.ndimage.label(
            counts[:, 0].reshape(shape) > 0, structure=np.ones((3, 3, 3)), output=np.int32
        )
        of_label = [np.bincount(grid.ravel(), kind, labels + 1).astype(np.intp) for kind in counts.T]
        sizes, at_rest, other, border, edge = of_label
        pixels = np.maximum(sizes, 1)
        boxes = scipy.ndimage.find_objects(grid)
        extents = [0.0, *(gap * max(b[0].stop - b[0].start, b[1].stop - b[1].start) for b in boxes)]
        clusters = _Clusters(
            grid,
            corner,
            np.array(extents),
            sizes,
            at_rest / pixels > STILL_SHARE,
            other / pixels > STILL_SHARE,
            (border / pixels > CUT_SHARE) | (edge > CUT_LENGTH * BORDER_PX * np.array(extents)),
            edge,
        )
        return clusters, held

    def _at_face(self, points: Array, focal: float) -> NDArray[np.bool_]:
        """Which points (n, 3) lie at a face of the box."""
        low, high = np.array(self.settings.box_min), np.array(self.settings.box_max)
        border = BORDER / focal * points[:, 2:]
        return np.asarray(((points < low + border) | (points > high - border)).any(axis=1))

    def _remember(self, c: _Clusters, chosen: NDArray[np.bool_], stamp_ns: int) -> None:
        """Keep when the chosen labels (m,) were seen, how large they are, and their cells, grown."""
        self._most, self._seen_ns = max(self._most, int(c.sizes[chosen].sum())), stamp_ns
        self._last = c.corner - GROWN, _grown_cells(chosen, c.grid, GROWN)

    def _continuing(self, c: _Clusters) -> int | None:
        """Label of the cluster that overlaps the last target most, or None."""
        if self._last is None:
            return None
        large = c.sizes >= self.settings.min_pixels
        # what reaches in from outside may be a hand: it does not make clutter of a target at rest
        clutter = c.still & (c.cut | (large & ~c.still & ~c.cut).any())
        corner, last = self._last
        overlap = _overlap(c.grid, last, corner - c.corner, len(c.sizes))
        overlap[~large | clutter] = 0
        overlap[0] = 0
        return int(overlap.argmax()) if overlap.any() else None

    def _is_settled(self, c: _Clusters) -> bool:
        """Whether it is known what stands still, or nothing does: the view is one thing, or moves as one."""
        large = c.sizes[1:] >= self.settings.min_pixels
        whole = not c.cut[1:][large].any()
        return self._still.observed_s >= SETTLING_S or (
            whole and (large.sum() == 1 or bool(c.moved[1:][large].all()))
        )

    def _first(self, c: _Clusters, settled: bool) -> int:
        """Label of a target that is new, or seen again after a gap."""
        large = c.sizes >= self.settings.min_pixels
        large[0] = False
        if not large.any():
            raise FrameRejected('no_target', f'the largest cluster has {c.sizes[1:].max()} pixels')
        if not settled:
            raise FrameRejected(SETTLING, f'{large.sum()} things in the box, or one that reaches out of it')
        for kind in (large & ~c.still & ~c.cut, large & ~c.still, large & ~c.cut):
            if kind.any():
                return int(np.where(kind, c.sizes, 0).argmax())
        raise FrameRejected('no_target', 'what is in the box stands still and reaches out of it')

    def _is_touched(self, c: _Clusters, main: int, stamp_ns: int) -> bool:
        """Whether the target has become one with something that reaches in from outside, not long ago."""
        lately = stamp_ns - self._seen_ns < LONGEST_TOUCH_NS
        reaches_out = c.outside[main] > self.settings.min_part_pixels
        return bool(lately and reaches_out and c.sizes[main] > MAX_GROWTH * self._most > 0)

    def _parts(self, c: _Clusters, main: int) -> list[int]:
        """Labels of parts that belong to the target but do not touch it."""
        s = self.settings
        part = (c.sizes >= s.min_part_pixels) & ~c.still & ~c.cut
        part[[0, main]] = False
        if self._last is None or not part.any():
            return []
        reach = s.part_gap * c.extents[main]
        away = scipy.ndimage.distance_transform_edt(c.grid != main) * s.cluster_gap  # px
        total, parts = int(c.sizes[main]), []
        for k in sorted(np.flatnonzero(part), key=lambda k: -c.sizes[k]):
            if total + c.sizes[k] <= MAX_GROWTH * self._most and away[c.grid == k].min() <= reach:
                parts.append(int(k))
                total += int(c.sizes[k])
        return parts


def mark_box(depth: NDArray[np.float32], camera: Camera, box: Array, region: Region, marks: Marks) -> InBox:
    """Mark (h, w) which pixels of a region show points in a box (2, 3), and clear the other marks.

    Metres, optical frame; the borders belong to the box.
    """
    count, v0, v1, u0, u1, nearest, farthest = _mark_box(
        depth, camera.fx, camera.fy, camera.cx, camera.cy, box[0], box[1], np.array(region), marks
    )
    return InBox(count, (v0, v1, u0, u1), nearest, farthest)


def _grown(region: Region, pixels: int, camera: Camera) -> Region:
    """A region with so many pixels around it, as far as the image reaches."""
    v0, v1, u0, u1 = region
    rows = max(0, v0 - pixels), min(camera.height, v1 + pixels)
    return (*rows, max(0, u0 - pixels), min(camera.width, u1 + pixels))


@kernel()
def _grown_cells(chosen: NDArray[np.bool_], grid: NDArray[np.int32], by: int) -> NDArray[np.bool_]:
    """The cells of a grid (a, b, c) whose labels are chosen (m,), in a grid that is larger all round."""
    a, b, c = grid.shape
    out = np.zeros((a + 2 * by, b + 2 * by, c + 2 * by), np.bool_)
    for i in range(a):
        for j in range(b):
            for k in range(c):
                if not chosen[grid[i, j, k]]:
                    continue
                for x in range(-by, by + 1):
                    for y in range(-by + abs(x), by - abs(x) + 1):
                        reach = by - abs(x) - abs(y)
                        for z in range(-reach, reach + 1):
                            out[by + i + x, by + j + y, by + k + z] = True
    return out


@kernel()
def _overlap(
    grid: NDArray[np.int32], cells: NDArray[np.bool_], corner: NDArray[np.int32], labels: int
) -> NDArray[np.intp]:
    """How many cells (a, b, c) that begin at a corner of a grid are set, by label in the grid."""
    counts = np.zeros(labels, np.intp)
    for i in range(max(0, -corner[0]), min(cells.shape[0], grid.shape[0] - corner[0])):
        for j in range(max(0, -corner[1]), min(cells.shape[1], grid.shape[1] - corner[1])):
            for k in range(max(0, -corner[2]), min(cells.shape[2], grid.shape[2] - corner[2])):
                if cells[i, j, k]:
                    counts[grid[corner[0] + i, corner[1] + j, corner[2] + k]] += 1
    return counts


@kernel()
def _mark_box(
    depth: NDArray[np.float32], fx: float, fy: float, cx: float, cy: float, low: Array, high: Array,
    region: NDArray[np.intp], marks: Marks,
) -> tuple[int, int, int, int, int, float, float]:  # fmt: skip
    n, first, last, left, right, nearest, farthest = 0, depth.shape[0], 0, depth.shape[1], 0, np.inf, -np.inf
    for v in range(region[0], region[1]):
        for u in range(region[2], region[3]):
            z = float(depth[v, u])
            marks[v, u] = 0
            if not z > 0 or not low[2] <= z <= high[2]:
                continue
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
                marks[v, u] = IN_BOX
                n += 1
                first, last, left, right = min(first, v), v + 1, min(left, u), max(right, u + 1)
                nearest, farthest = min(nearest, z), max(farthest, z)
    return n, first, last, left, right, nearest, farthest


@inlined
def _layer(z: float, deep: float) -> int:
    """A depth's layer of the grid: a cell is as deep as it is wide, so depth counts by its logarithm."""
    return int(np.log(min(max(z, LEAST_RANGE), MOST_RANGE) / LEAST_RANGE) * deep)


@kernel()
def _block(
    region: NDArray[np.intp], nearest: float, farthest: float, gap: float, deep: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First cell (3,) of the grid's block that holds a region between two depths, and its shape (3,)."""
    low, high = np.empty(3, np.int32), np.empty(3, np.int32)
    for axis in range(2):
        low[axis], high[axis] = int(region[2 * axis] / gap), int((region[2 * axis + 1] - 1) / gap)
    low[2], high[2] = _layer(nearest, deep), _layer(farthest, deep)
    return low, high - low + 1


@kernel()
def _gather(
    depth: NDArray[np.float32], intrinsics: Array, marks: Marks, region: NDArray[np.intp], planes: Array,
    least: float, box: Array, border: float, gap: float, deep: float, corner: NDArray[np.int32],
    shape: NDArray[np.int32], cells: NDArray[np.int32], counts: NDArray[np.int32],
) -> int:  # fmt: skip
    """Sort the marked pixels of a region into the cells (n,) of a block; return how many lie in planes.

    ``cells`` (h, w) is each pixel's, -1 without one. ``counts`` (n, 5): all, those still, moved, at a border
    (``border``, relative to the depth, is near to a face of the box), at the image's edge. ``planes`` (m, 5)
    are what the target stands on, and how uneven they are.
    """
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    layer, inner, outer, held = 0, np.inf, -np.inf, 0  # the layer of the point before, and its bounds
    for v in range(region[0], region[1]):
        at_row = v < BORDER_PX or v >= height - BORDER_PX
        row = (int(v / gap) - corner[0]) * shape[1]
        for u in range(region[2], region[3]):
            mark = marks[v, u]
            cells[v, u] = -1
            if not mark:
                continue
            z = float(depth[v, u])
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            on_plane = False
            for k in range(len(planes)):
                up = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z + planes[k, 3]
                on_plane = on_plane or abs(up) < planes[k, 4] * tolerance(z, least)
            if on_plane:
                held += 1
                continue
            if not inner < min(max(z, LEAST_RANGE), MOST_RANGE) < outer:
                layer = _layer(z, deep)
                inner, outer = LEAST_RANGE * np.exp(layer / deep), LEAST_RANGE * np.exp((layer + 1) / deep)
            k = min(max(layer - corner[2], 0), shape[2] - 1)
            cell = cells[v, u] = (row + int(u / gap) - corner[1]) * shape[2] + k
            near, edge = border * z, at_row or u < BORDER_PX or u >= width - BORDER_PX
            at_border = edge or x < box[0, 0] + near or x > box[1, 0] - near
            at_border = at_border or y < box[0, 1] + near or y > box[1, 1] - near
            at_border = at_border or z < box[0, 2] + near or z > box[1, 2] - near
            counts[cell, 0] += 1
            if mark & STILL:
                counts[cell, 1] += 1
            if mark & MOVED:
                counts[cell, 2] += 1
            if at_border:
                counts[cell, 3] += 1
                counts[cell, 4] += edge
    return held


@kernel()
def _mark(
    cells: NDArray[np.int32], region: NDArray[np.intp], chosen: NDArray[np.bool_], mask: NDArray[np.bool_]
) -> Region:
    """Set a mask (h, w) where a pixel's cell (n,) is chosen; the box of these pixels."""
    v0, v1, u0, u1 = mask.shape[0], 0, mask.shape[1], 0
    for v in range(region[0], region[1]):
        for u in range(region[2], region[3]):
            if cells[v, u] >= 0 and chosen[cells[v, u]]:
                mask[v, u] = True
                v0, v1, u0, u1 = min(v0, v), v + 1, min(u0, u), max(u1, u + 1)
    return v0, v1, u0, u1


def _at_edge(rows: NDArray[np.intp], columns: NDArray[np.intp], camera: Camera) -> NDArray[np.bool_]:
    """Which pixels (n,) lie at the image's edge."""
    n = BORDER_PX
    outer_row = (rows < n) | (rows >= camera.height - n)
    return np.asarray(outer_row | (columns < n) | (columns >= camera.width - n))
