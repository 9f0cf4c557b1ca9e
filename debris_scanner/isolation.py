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

"""Target isolation: the pass-through box, then the clusters that make up the target.

The box is thesis part T2 (Trowbridge 2014, section 3.2). Inside it the points fall into clusters,
found on a coarse voxel grid. The target is the largest one, or, once there is one, what continues it,
with the parts that lie apart from it: a panel behind the body, say. What stands still, or reaches
out of the box, is clutter as long as there is something else.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from debris_scanner.box_points import points_in_box
from debris_scanner.camera import Camera
from debris_scanner.frames import FrameRejected
from debris_scanner.geometry import Array
from debris_scanner.parameters import parameter
from debris_scanner.still_depth import StillDepth

STILL_SHARE = 0.7  # of a cluster's pixels, for it to stand still
CUT_SHARE = 0.02  # of a cluster's pixels at the faces of the box or the image's edge, for it to reach out
BORDER = 0.015  # m
BORDER_PX = 3
SETTLING_S = 1.3  # until what stands still has shown it
MAX_GROWTH = 1.5  # parts may make the target this much larger than it ever was


@dataclass(frozen=True)
class IsolationSettings:
    """Where the target is looked for, in the sensor's optical frame."""

    box_min: tuple[float, float, float] = parameter(
        (-0.4, -0.4, 0.3), 'lower corner of the pass-through box', 'm'
    )
    box_max: tuple[float, float, float] = parameter(
        (0.4, 0.4, 1.2), 'upper corner of the pass-through box', 'm'
    )
    cluster_gap: float = parameter(
        0.025, 'parts of one target are at most about this far apart', 'm', 0.001, 1.0
    )
    part_gap: float = parameter(
        0.15, 'and parts that move at most this far: what joins them may be out of sight', 'm', 0.0, 1.0
    )
    min_pixels: int = parameter(400, 'a smaller target is not tracked', 'px', 50, 10**6)
    min_part_pixels: int = parameter(40, 'a smaller part is a speck', 'px', 1, 10**6)
    margin: int = parameter(16, 'free border of the window around the target', 'px', 2, 200)


@dataclass(frozen=True)
class _Clusters:
    """Points (n, 3) with their label (n,) each; per label (0 is none): pixels, and what speaks against it."""

    points: Array
    label: NDArray[np.intp]
    grid: NDArray[np.int32]  # labels of the voxels
    sizes: NDArray[np.intp]
    still: NDArray[np.bool_]
    cut: NDArray[np.bool_]


class TargetIsolator:
    """Finds the target's pixels frame by frame; remembers where it was last seen, and what stands still."""

    def __init__(self, settings: IsolationSettings) -> None:
        self.settings = settings
        self._still = StillDepth()
        self._last: NDArray[np.bool_] | None = None  # the target's voxels, a little grown
        self._most = 0  # pixels it ever had
        self.still_pixels = 0  # of the latest frame, left out because they stand still

    def mask(self, depth: NDArray[np.float32], camera: Camera, stamp_ns: int) -> NDArray[np.bool_]:
        """Pixels (h, w) of a depth image (metres) that show the target.

        Raises:
            FrameRejected: ``no_target`` when too few points lie in the box, or nothing but clutter;
                ``settling`` while it is not yet clear which of several things stands still.
        """
        s = self.settings
        points, v, u = points_in_box(depth, camera, np.array(s.box_min), np.array(s.box_max))
        if len(points) < s.min_pixels:
            raise FrameRejected('no_target', f'{len(points)} pixels in the box')
        still = self._still.observe(camera, stamp_ns, v, u, points[:, 2])
        clusters = self._clusters(points, still, _at_edge(v, u, camera))
        main = self._continuing(clusters)
        if main is None:
            main = self._first(clusters)
        labels = [main, *self._parts(clusters, main)]
        chosen = np.isin(clusters.label, labels)
        left_out = clusters.still & (clusters.sizes >= s.min_part_pixels)
        left_out[[0, *labels]] = False
        self.still_pixels = int(clusters.sizes[left_out].sum())
        grid = np.isin(clusters.grid, np.unique(clusters.label[chosen]))
        self._last = ndimage.binary_dilation(grid, iterations=2)
        self._most = max(self._most, int(chosen.sum()))
        mask = np.zeros(depth.shape, np.bool_)
        mask[v[chosen], u[chosen]] = True
        return mask

    def _clusters(self, points: Array, still: NDArray[np.bool_], at_edge: NDArray[np.bool_]) -> _Clusters:
        s = self.settings
        low, high = np.array(s.box_min), np.array(s.box_max)
        voxel = np.floor((points - low) / s.cluster_gap).astype(np.intp)
        occupied = np.zeros(np.ceil((high - low) / s.cluster_gap).astype(int) + 1, np.bool_)
        occupied[voxel[:, 0], voxel[:, 1], voxel[:, 2]] = True
        grid, count = ndimage.label(occupied, structure=np.ones((3, 3, 3)))
        label = grid[voxel[:, 0], voxel[:, 1], voxel[:, 2]].astype(np.intp)
        sizes = np.bincount(label, minlength=count + 1)
        border = at_edge | ((points < low + BORDER) | (points > high - BORDER)).any(axis=1)
        whole = np.maximum(sizes, 1)
        return _Clusters(
            points,
            label,
            grid,
            sizes,
            np.bincount(label, still, count + 1) / whole > STILL_SHARE,
            np.bincount(label, border, count + 1) / whole > CUT_SHARE,
        )

    def _continuing(self, c: _Clusters) -> int | None:
        """The label that fills most of where the target was last; None when there is none."""
        if self._last is None or self._last.shape != c.grid.shape:
            return None
        large = c.sizes >= self.settings.min_pixels
        clutter = c.still & (c.cut | (large & ~c.still).any())
        overlap = np.bincount(c.grid[self._last], minlength=len(c.sizes))
        overlap[~large | clutter] = 0
        overlap[0] = 0
        return int(overlap.argmax()) if overlap.any() else None

    def _first(self, c: _Clusters) -> int:
        """The label of a target that is new, or seen again after a gap."""
        large = c.sizes >= self.settings.min_pixels
        large[0] = False
        if not large.any():
            raise FrameRejected('no_target', f'the largest cluster has {c.sizes[1:].max()} pixels')
        settled = self._still.observed_s >= SETTLING_S
        if not settled and (large.sum() > 1 or c.cut[large].any()):
            raise FrameRejected('settling', f'{large.sum()} things in the box, or one that reaches out of it')
        for kind in (large & ~c.still & ~c.cut, large & ~c.still, large & ~c.cut):
            if kind.any():
                return int(np.where(kind, c.sizes, 0).argmax())
        raise FrameRejected('no_target', 'what is in the box stands still and reaches out of it')

    def _parts(self, c: _Clusters, main: int) -> list[int]:
        """Labels of what belongs to the target but does not touch it."""
        s = self.settings
        part = (c.sizes >= s.min_part_pixels) & ~c.still & ~c.cut
        part[[0, main]] = False
        if self._last is None or not part.any():
            return []
        away = ndimage.distance_transform_edt(c.grid != main) * s.cluster_gap
        total, parts = int(c.sizes[main]), []
        for k in sorted(np.flatnonzero(part), key=lambda k: -c.sizes[k]):
            if total + c.sizes[k] <= MAX_GROWTH * self._most and away[c.grid == k].min() <= s.part_gap:
                parts.append(int(k))
                total += int(c.sizes[k])
        return parts


def _at_edge(rows: NDArray[np.int32], columns: NDArray[np.int32], camera: Camera) -> NDArray[np.bool_]:
    """Which pixels (n,) lie at the image's edge."""
    n = BORDER_PX
    outer_row = (rows < n) | (rows >= camera.height - n)
    return np.asarray(outer_row | (columns < n) | (columns >= camera.width - n))
