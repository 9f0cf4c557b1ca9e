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

"""Many pairs of views in one call of a kernel: where the views' arrays lie, and in which order to take pairs.

Called pair by pair, a kernel waits for memory: each image is read anew for each pair, and Python takes as
long again. Here the pairs that are projected into one image come one after the other.
"""

from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.optional import array_at, inlined, pointer
from debris_scanner.sensing.silhouette import Mask, Steps
from debris_scanner.sensing.views import View

Image = NDArray[np.float32]
Addresses = NDArray[np.intp]

# Columns of the addresses, and the types of the arrays there.
POINTS, NORMALS, ANCHORS, RIM_POINTS, RIM_NORMALS, ON_EDGE = range(6)
DEPTH, DEPTH_MAP, NORMAL_MAP, BESIDE, SIDES, EDGES, OUTWARD = range(6, 13)
TYPES = (*(np.float32,) * 5, np.uint8, *(np.float32,) * 3, np.int16, np.bool_, np.uint16, np.float32)
# Columns of the sizes.
POINT_COUNT, RIM_COUNT, HEIGHT, WIDTH, OUTWARD_COUNT = range(5)


class ViewTable:
    """Where views' arrays lie, which it keeps.

    Args:
        views: n of them, which do not change meanwhile.

    Attributes:
        addresses: (n, 13), of the arrays.
        sizes: (n, 5): points, rim points, height, width, outward directions.
        intrinsics: (n, 4): fx, fy, cx, cy.
        resolution, footprint, usual_range: (n,), m.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self.views = list(views)
        self._arrays = [_arrays(view) for view in views]
        self.addresses = np.array([[_address(a) for a in arrays] for arrays in self._arrays], np.intp)
        self.sizes = np.array([_sizes(view) for view in views], np.intp)
        self.intrinsics = np.array([view.intrinsics for view in views])
        self.resolution = np.array([view.resolution for view in views])
        self.footprint = np.array([view.footprint for view in views])
        self.usual_range = self.footprint * np.array([view.frame.camera.focal for view in views])

    def some(self, chosen: Sequence[int]) -> Self:
        """Of chosen views alone."""
        other, rows = copy(self), np.array(chosen, np.intp)
        other.views, other._arrays = [self.views[k] for k in chosen], [self._arrays[k] for k in chosen]
        for name in ('addresses', 'sizes', 'intrinsics', 'resolution', 'footprint', 'usual_range'):
            setattr(other, name, getattr(self, name)[rows])
        return other


def both_directions(pairs: Sequence[tuple[int, int]]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Both directions (2 m, 2) of m pairs, source and reference, and the order (2 m,) in which to take them.

    The first m project a pair's second view into its first one's image, the others the first into the second.
    """
    ends = np.array(pairs, np.intp).reshape(-1, 2)
    directions = np.concatenate([ends[:, ::-1], ends])
    return directions, np.argsort(directions[:, 1], kind='stable')


@inlined
def vectors(addresses: Addresses, column: int, n: int) -> Image:
    """In a kernel, vectors (n, 3) of a row of the table."""
    return array_at(pointer(addresses[column]), (n, 3), np.float32)


@inlined
def image(addresses: Addresses, column: int, h: int, w: int) -> Image:
    """In a kernel, an image (h, w) of a row of the table."""
    return array_at(pointer(addresses[column]), (h, w), np.float32)


@inlined
def normal_image(addresses: Addresses, h: int, w: int) -> Image:
    """In a kernel, the normals (h, w, 3) of a row of the table."""
    return array_at(pointer(addresses[NORMAL_MAP]), (h, w, 3), np.float32)


@inlined
def steps(addresses: Addresses, h: int, w: int) -> Steps:
    """In a kernel, the steps (h, w, 2) beside the silhouette of a row of the table."""
    return array_at(pointer(addresses[BESIDE]), (h, w, 2), np.int16)


@inlined
def open_sides(addresses: Addresses) -> Mask:
    """In a kernel, the open sides (4,) of a row of the table."""
    return array_at(pointer(addresses[SIDES]), (4,), np.bool_)


def _arrays(view: View) -> list[NDArray[np.generic]]:
    frame, rim, edges = view.frame, view.rim, view.edges
    arrays = (
        view.points, view.normals, view.anchors, rim.points, rim.normals, rim.edge,
        frame.depth, view.depth_map, view.normal_map, view.beside, view.open_sides,
        edges.index, edges.outward,
    )  # fmt: skip
    return [np.require(array, kind, 'C') for array, kind in zip(arrays, TYPES, strict=True)]


def _sizes(view: View) -> tuple[int, int, int, int, int]:
    h, w = view.frame.depth.shape
    return len(view.points), len(view.rim.points), h, w, len(view.edges.outward)


def _address(array: NDArray[np.generic]) -> int:
    return int(array.__array_interface__['data'][0])
