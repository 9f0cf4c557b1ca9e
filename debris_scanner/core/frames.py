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

"""The data that passes between the stages: depth frames, target frames, key frames, the model.

Every input, cloud or image, becomes a depth image with its pinhole camera first. A stamp in integer
nanoseconds identifies a frame everywhere.

`LazyFrames` holds posed frames that are restored on request. `Model` is the surface that a scan finds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.camera import (
    Camera,
    finite,
    fit_pinhole,
    rasterise,
    rasterised,
    virtual_camera,
)
from debris_scanner.core.geometry import Array, vertex_normals
from debris_scanner.core.open3d_library import load_open3d

if TYPE_CHECKING:
    import open3d
    import trimesh

NEAREST_NEIGHBOUR = 0.8  # distance of a voxel grid's nearest neighbours over its edge (measured)
SPACING_SAMPLE = 500  # points whose nearest neighbours tell the spacing
NO_FOOTPRINT = 0.0015  # m: of a frame without depth; a Kinect's at 0.8 m

Kept = TypeVar('Kept')
Posed = tuple['TargetFrame', Array]  # T_target_sensor (4, 4)


class FrameRejected(Exception):
    """A frame that cannot be used; ``reason`` is the key it is counted under in summary.json."""

    def __init__(self, reason: str, detail: str = '') -> None:
        super().__init__(f'{reason}: {detail}' if detail else reason)
        self.reason = reason


@dataclass(frozen=True)
class DepthFrame:
    """One input of the sensor: depth (h, w) float32 metres, 0 where invalid; rgb (h, w, 3) uint8.

    It takes depth in millimetres, too, if that is uint16, and any float of at least 32 bits; NaN and Inf
    become 0. A grey picture (h, w) of any number becomes three equal channels: see :func:`grey_picture`.

    Raises:
        ValueError: depth, picture or stamp have another type or shape than these; the message says which.
    """

    stamp_ns: int
    depth: NDArray[np.float32]
    camera: Camera
    rgb: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise ValueError(f'camera must be a Camera, not {type(self.camera).__name__}')
        object.__setattr__(self, 'stamp_ns', _whole_nanoseconds(self.stamp_ns))
        object.__setattr__(self, 'depth', _metres(self.depth, self.camera))
        object.__setattr__(self, 'rgb', _picture(self.rgb, self.camera))

    @staticmethod
    def from_cloud(
        stamp_ns: int, points: NDArray[np.float32], rgb: NDArray[np.uint8] | None = None
    ) -> 'DepthFrame':
        """From a cloud (h, w, 3) or (n, 3), metres, optical frame, NaN or Inf where invalid.

        A cloud that fits no pinhole camera is rasterised into a virtual one, as fine as the cloud. Its
        points have colours (..., 3) or brightness (...), as a picture's pixels do.
        """
        if rgb is not None and rgb.ndim == points.ndim - 1:
            rgb = grey_picture(rgb)
        camera = fit_pinhole(points)
        if camera is None:
            camera = virtual_camera(points)
            if rgb is not None:
                black = np.zeros((1, 3), np.uint8)  # where there is no point
                rgb = np.concatenate([rgb.reshape(-1, 3), black])[rasterised(points, camera)]
            return DepthFrame(stamp_ns, rasterise(points, camera), camera, rgb)
        z = points[..., 2]
        valid = finite(points) & (z > 0)
        return DepthFrame(stamp_ns, np.where(valid, z, np.float32(0)), camera, rgb)


def _whole_nanoseconds(stamp: Any) -> int:
    """A stamp as Python's int."""
    if isinstance(stamp, bool) or not isinstance(stamp, Integral):
        raise ValueError(f'stamp_ns must be whole nanoseconds, not {stamp!r} ({type(stamp).__name__})')
    return int(stamp)


def _metres(depth: Any, camera: Camera) -> NDArray[np.float32]:
    """A depth image (h, w) in metres, 0 where invalid, of what has the camera's size and a known unit."""
    if not isinstance(depth, np.ndarray):
        raise ValueError(f'depth must be a numpy array, not {type(depth).__name__}')
    if depth.shape != (camera.height, camera.width):
        turned = ': is it transposed?' if depth.shape == (camera.width, camera.height) else ''
        raise ValueError(
            f'depth has shape {depth.shape}, the camera (height, width) = '
            f'({camera.height}, {camera.width}){turned}'
        )
    if (depth.dtype.kind, depth.dtype.itemsize) == ('u', 2):
        return depth.astype(np.float32) * np.float32(0.001)
    if not np.issubdtype(depth.dtype, np.floating) or depth.dtype.itemsize < 4:
        raise ValueError(
            f'depth must be float32 or float64 in metres, or uint16 in millimetres, not {depth.dtype}'
        )
    metres = np.ascontiguousarray(depth, np.float32)
    valid = np.isfinite(metres)
    return metres if valid.all() else np.where(valid, metres, np.float32(0))


def _picture(rgb: Any, camera: Camera) -> NDArray[np.uint8] | None:
    """A picture (h, w, 3) of the camera's size; a grey one gets three equal channels."""
    if rgb is None:
        return None
    if not isinstance(rgb, np.ndarray) or (
        rgb.dtype != np.uint8 and (rgb.ndim != 2 or rgb.dtype.kind not in 'uif')
    ):
        kind = f'an array of {rgb.dtype}' if isinstance(rgb, np.ndarray) else type(rgb).__name__
        raise ValueError(f'a picture must be (h, w) of numbers, or (h, w, 3) of uint8, not {kind}')
    size = (camera.height, camera.width)
    if rgb.shape not in (size, (*size, 3)):
        raise ValueError(f'the picture has shape {rgb.shape}, the depth {size}: register the two')
    return grey_picture(rgb) if rgb.ndim == 2 else rgb


def grey_picture(brightness: NDArray[Any]) -> NDArray[np.uint8]:
    """Brightness (...) of any number type as three equal channels (..., 3); bytes stay as they are.

    Infrared and amplitude span a thousand to one: levels are by the square root, as even as the noise of
    light, up to the brightest hundredth of what is not dark. Who compares two images must allow for a gain.
    """
    if brightness.dtype == np.uint8:
        return np.repeat(brightness[..., None], 3, axis=-1)
    values = np.nan_to_num(brightness.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    lit = values[values > 0]
    if not len(lit):
        return np.zeros((*values.shape, 3), np.uint8)
    top = np.float32(np.percentile(lit[:: max(1, len(lit) // 10_000)], 99))
    levels = 254 * np.sqrt(np.clip(values / top, 0, 1))  # 255 would be saturated
    return np.repeat(np.rint(levels).astype(np.uint8)[..., None], 3, axis=-1)


@dataclass(frozen=True)
class TargetFrame:
    """The target alone, a window of the depth image, with normals from the plane fit.

    All images have the window's shape (h, w). Off the target ``depth`` is 0; where no plane fits,
    ``depth_fit`` and ``normals`` are 0. In a porous image the pores have a fit but no depth. Where an error
    of the sensor is taken off ``depth``, ``raw`` is what it gave.
    """

    stamp_ns: int
    camera: Camera  # of the window
    depth: NDArray[np.float32]  # metres
    depth_fit: NDArray[np.float32]  # metres, of the locally fitted plane
    normals: NDArray[np.float32]  # (h, w, 3), unit, towards the sensor
    rgb: NDArray[np.uint8] | None = None  # (h, w, 3)
    raw: NDArray[np.float32] | None = None  # (h, w), metres

    @property
    def measured(self) -> NDArray[np.float32]:
        """Depth (h, w), metres, as the sensor gave it."""
        return self.depth if self.raw is None else self.raw

    @property
    def inner_size(self) -> tuple[int, int]:
        """Height and width, pixels, of what the window shows of the target."""
        seen = self.depth > 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        return (int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1) if len(rows) else (0, 0)

    @cached_property
    def footprint(self) -> float:
        """Size of a pixel at the target's range, metres: what is small and near is a multiple of it."""
        return median_footprint(self.depth, self.camera)

    @cached_property
    def pixels(self) -> int:
        """How many show the target."""
        return int(np.count_nonzero(self.depth))


class UnfittedFrame(TargetFrame):
    """A target frame whose planes are fitted once somebody asks for them; a copy of it is fitted."""

    @classmethod
    def of(
        cls,
        stamp_ns: int,
        camera: Camera,
        depth: NDArray[np.float32],
        rgb: NDArray[np.uint8] | None,
        fit: Callable[[], tuple[NDArray[np.float32], NDArray[np.float32]]],
    ) -> 'UnfittedFrame':
        """Arguments as :class:`TargetFrame`; ``fit`` makes its fitted depth (h, w) and normals (h, w, 3)."""
        frame = object.__new__(cls)
        frame.__dict__.update(stamp_ns=stamp_ns, camera=camera, depth=depth, rgb=rgb, raw=None, _fit=fit)
        return frame

    def __getattr__(self, name: str) -> Any:
        """Depth and normals of the planes, which are attributes from the first time on."""
        if name not in ('depth_fit', 'normals'):
            raise AttributeError(name)
        self.__dict__['depth_fit'], self.__dict__['normals'] = self.__dict__['_fit']()
        return self.__dict__[name]


def median_footprint(depth: NDArray[np.float32], camera: Camera) -> float:
    """Size of a pixel at the median of a depth image (h, w), metres."""
    thinned = depth[::2, ::2]
    seen = thinned[thinned > 0]
    if not len(seen):
        seen = depth[depth > 0]
    return _median(seen) / camera.focal if len(seen) else NO_FOOTPRINT


def _median(values: NDArray[np.float32]) -> float:
    """Median of some numbers (n,): numpy's, in a third of the time, for none is NaN."""
    half = len(values) // 2
    around = [half - 1, half] if len(values) % 2 == 0 else [half]
    return float(np.partition(values, around)[around].mean())


@dataclass
class KeyFrame:
    """A target frame that is kept, with its pose in the target frame (optimised later) and covariance."""

    frame: TargetFrame
    T_target_sensor: Array  # (4, 4)
    path_rad: float  # rotation travelled since the first key frame, radians
    covariance: Array = field(default_factory=lambda: np.eye(6) * 1e-8)  # rotation, translation
    submap: int = 0  # poses of different submaps cannot be compared until a closure joins them

    @property
    def stamp_ns(self) -> int:
        """The frame's identity."""
        return self.frame.stamp_ns


@dataclass
class KeyPose:
    """A key frame without its images and covariance."""

    stamp_ns: int
    T_target_sensor: Array  # (4, 4), comparable within a submap
    path_rad: float
    submap: int = 0
    original_submap: int = 0  # submap it was made in, before any were joined
    linked: bool = False  # odometry connects it with the key frame before
    T_previous: Array | None = None  # (4, 4), this in the key frame before, as tracked; None unless linked
    usable_for_mapping: bool = True  # unoccluded, and agrees with a neighbour
    slipped: bool = False  # while it turned from the key frame before to this one, tracking slipped
    added: bool = False  # a tracked frame, made a key frame at the end of the scan


class LazyFrames(Sequence[Posed], Generic[Kept]):
    """Posed frames, each restored whenever it is requested.

    Hundreds of frames with their normals take as many megabytes; restoring one takes a millisecond.

    Args:
        kept: the stored form of each frame.
        restore: makes a frame and its pose from it.
    """

    def __init__(self, kept: Sequence[Kept], restore: Callable[[Kept], Posed]) -> None:
        self._kept = kept
        self._restore = restore

    def __len__(self) -> int:
        return len(self._kept)

    @overload
    def __getitem__(self, index: int) -> Posed: ...

    @overload
    def __getitem__(self, index: slice) -> 'LazyFrames[Kept]': ...

    def __getitem__(self, index: int | slice) -> 'Posed | LazyFrames[Kept]':
        if isinstance(index, slice):
            return LazyFrames(self._kept[index], self._restore)
        return self._restore(self._kept[index])


def point_spacing(points: NDArray[np.floating]) -> float:
    """Edge of the voxel grid that thinned a surface to these points (n, 3), from their nearest neighbours."""
    if len(points) < 2:
        return NO_FOOTPRINT
    tree = scipy.spatial.cKDTree(points)
    sample = points[:: max(1, len(points) // SPACING_SAMPLE)]
    return float(np.median(tree.query(sample, k=2)[0][:, 1])) / NEAREST_NEIGHBOUR


@dataclass(frozen=True)
class Texture:
    """An image laid around a mesh. A vertex where two pieces of it meet comes once for each of them."""

    image: NDArray[np.uint8]  # (h, w, 3)
    observed: NDArray[np.bool_]  # (h, w), False of what fills a gap
    vertices: NDArray[np.int32]  # (k,) of the mesh
    triangles: NDArray[np.int32]  # (t, 3) of these k, in the mesh's order
    uv: NDArray[np.float32]  # (k, 2) shares of the image's width and height, from its upper left corner


@dataclass(frozen=True)
class ClosedMesh:
    """Watertight surface, metres, target frame: what was seen, and what fills the gaps."""

    vertices: NDArray[np.float32]  # (m, 3)
    triangles: NDArray[np.int32]  # (t, 3), counter-clockwise seen from outside
    observed: NDArray[np.bool_]  # (t,), False of what fills a gap
    rgb: NDArray[np.uint8] | None = None  # (m, 3)
    texture: Texture | None = None

    @property
    def normals(self) -> Array:
        """Unit normals (m, 3) of the vertices, outward."""
        return vertex_normals(self.vertices, self.triangles)


@dataclass(frozen=True, repr=False)
class Model:
    """Surface of the target: refined cloud and triangle mesh, metres, target frame.

    The target frame has the attitude that the first key frame had in the first model, and its origin at the
    centroid.
    """

    points: NDArray[np.float32]  # (n, 3)
    normals: NDArray[np.float32]  # (n, 3), unit, outward
    vertices: NDArray[np.float32]  # (m, 3) of the mesh
    triangles: NDArray[np.int32]  # (t, 3), counter-clockwise seen from outside
    rgb: NDArray[np.uint8] | None = None  # (n, 3)
    vertex_rgb: NDArray[np.uint8] | None = None  # (m, 3)
    closed: ClosedMesh | None = None  # of a finished scan

    def __repr__(self) -> str:
        return f'Model({len(self.points)} points, {len(self.triangles)} triangles)'

    @cached_property
    def spacing(self) -> float:
        """Distance between neighbouring points of the cloud, metres."""
        return point_spacing(self.points)

    @property
    def radius(self) -> float:
        """Largest distance of a point from the origin, metres."""
        return float(np.linalg.norm(self.points, axis=1).max())

    def to_trimesh(self) -> 'trimesh.Trimesh':
        """The mesh of what was seen, metres, target frame, with its colours where it has any."""
        import trimesh  # late: few programs need it

        return trimesh.Trimesh(self.vertices, self.triangles, vertex_colors=self.vertex_rgb, process=False)

    def to_open3d(self) -> 'open3d.geometry.TriangleMesh':
        """The mesh of what was seen, metres, target frame, with normals, and colours where it has any.

        Raises:
            MissingLibrary: Open3D is not installed.
        """
        o3d = load_open3d()
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(self.vertices.astype(np.float64)),
            o3d.utility.Vector3iVector(self.triangles),
        )
        if self.vertex_rgb is not None:
            mesh.vertex_colors = o3d.utility.Vector3dVector(self.vertex_rgb / 255.0)
        mesh.compute_vertex_normals()
        return mesh
