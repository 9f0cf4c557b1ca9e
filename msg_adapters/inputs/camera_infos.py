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

"""The camera of an image by its CameraInfo: K or P, binned or a window, with its lens."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.rectification import Distortion, Rectifier
from msg_adapters.errors import WrongCameraInfo

WIDEST_DEG = 170.0  # of a pinhole camera's view, twice what its farthest pixel is off the axis
FINEST_RAD = 1e-6  # of a pixel: light is bent by more in any lens of less than half a metre
_K, _P = (0, 4, 2, 5), (0, 5, 2, 6)  # fx, fy, cx, cy in each
_IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


@dataclass(frozen=True)
class Lens:
    """How an image is seen: its camera, and what undoes its distortion."""

    camera: Camera  # of the frames that are made of it
    rectifier: Rectifier | None = None


def is_rectified(topic: str) -> bool:
    """Whether a topic of images says that they are rectified, as ``image_rect`` and ``image_rect_raw`` do."""
    image = topic.removesuffix('/compressedDepth').removesuffix('/compressed')
    return 'rect' in image.rsplit('/', 1)[-1].split('_')


def read_camera(info: Any, rectified: bool = False) -> Camera:
    """Camera of a CameraInfo, brought to the image's pixels where it is binned or a window.

    That is K, or P for rectified images and where K is the identity: a driver that left it as it was made.
    Rectified images without a P are seen by K.

    Raises:
        WrongCameraInfo: it has no finite focal lengths, or such that see more than WIDEST_DEG or
            less than FINEST_RAD a pixel.
    """
    bin_x, bin_y, roi = max(1, int(info.binning_x)), max(1, int(info.binning_y)), info.roi
    width, height = int(roi.width or info.width) // bin_x, int(roi.height or info.height) // bin_y
    return _window(_full(info, rectified), int(roi.x_offset), int(roi.y_offset), bin_x, bin_y, width, height)


def read_lens(info: Any, width: int, height: int, rectified: bool = False) -> Lens:
    """How an image of ``width`` x ``height`` pixels is seen.

    Raises:
        WrongCameraInfo: as :func:`read_camera`; a lens of no known model; or an image that is neither the
            whole sensor nor its window.
    """
    camera = _fitted(info, width, height, rectified)
    lens = None if rectified or not _sees(info.k, _K, info) else _distortion(info)
    if lens is None:
        return Lens(camera)
    try:
        rectifier = Rectifier(camera, lens)
    except ValueError as error:
        raise WrongCameraInfo(f'camera_info: {error}') from None
    return Lens(rectifier.camera, rectifier)


def of_rectified(info: Any) -> Any:
    """A CameraInfo of rectified images as one of raw images that need nothing: K as in P, no distortion."""
    if _sees(info.p, _P, info):
        info.k = [float(info.p[i]) for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)]
    info.d = []
    return info


def same_camera(a: Any, b: Any) -> bool:
    """Whether two CameraInfos may be of one camera, or of images registered to each other: size and K."""
    try:
        return read_camera(a).resembles(read_camera(b))
    except WrongCameraInfo:
        return False


def other_view(depth: Any, depth_info: Any, colour: Any, colour_info: Any) -> str:
    """Why a colour image does not show the pixels of a depth image; empty if it does.

    It does if size and frame are equal, and the camera too where the colour has a CameraInfo of its own. A
    frame of no name, or a number, tells nothing: then the cameras have to be known.

    Args:
        depth: Image or CompressedImage; of this its camera_info tells the size.
        depth_info: its CameraInfo, or None.
        colour: Image.
        colour_info: its own CameraInfo, or None.
    """
    if depth is None:
        return 'there is no depth'
    frames = depth.header.frame_id, colour.header.frame_id
    if frames[0] != frames[1]:
        return f'it is seen from {frames[1]}, depth from {frames[0]}: not registered'
    sized = depth if hasattr(depth, 'width') else depth_info
    if (colour.width, colour.height) != (sized.width, sized.height):
        return f'{colour.width}x{colour.height} pixels, depth has {sized.width}x{sized.height}'
    if colour_info is not None and depth_info is not None:
        if same_camera(depth_info, colour_info):
            return ''
        return 'its camera_info is of another camera than that of the depth: not registered'
    if not frames[0] or frames[0].isdecimal():
        return f'the frame {frames[0]!r} is no name, and it has no camera_info: not known to be registered'
    return ''


def _fitted(info: Any, width: int, height: int, rectified: bool) -> Camera:
    """The camera of an image of that size."""
    bin_x, bin_y, roi = max(1, int(info.binning_x)), max(1, int(info.binning_y)), info.roi
    full = _full(info, rectified)
    whole = int(info.width) // bin_x, int(info.height) // bin_y
    window = int(roi.width or info.width) // bin_x, int(roi.height or info.height) // bin_y
    if (width, height) == window:
        return _window(full, int(roi.x_offset), int(roi.y_offset), bin_x, bin_y, width, height)
    if (width, height) == whole:  # a window is named, but not cut out
        return _window(full, 0, 0, bin_x, bin_y, width, height)
    sizes = f'camera_info is of {whole[0]}x{whole[1]}, the image has {width}x{height}'
    raise WrongCameraInfo(sizes)


def _window(full: Camera, x: int, y: int, bin_x: int, bin_y: int, width: int, height: int) -> Camera:
    return _camera(
        full.fx / bin_x, full.fy / bin_y, (full.cx - x) / bin_x, (full.cy - y) / bin_y, width, height
    )


def _camera(*numbers: Any) -> Camera:
    try:
        return Camera(*numbers)
    except ValueError as error:
        raise WrongCameraInfo(f'camera_info: {error}') from None


def _full(info: Any, rectified: bool) -> Camera:
    """The camera of the whole sensor, unbinned."""
    by_p = rectified or [float(x) for x in info.k] == _IDENTITY
    for matrix, places in ((info.p, _P), (info.k, _K)) if by_p else ((info.k, _K),):
        if _sees(matrix, places, info):
            fx, fy, cx, cy = (float(matrix[i]) for i in places)
            return _camera(fx, fy, cx, cy, int(info.width), int(info.height))
    fx, fy, cx, cy = (float(info.k[i]) for i in _K)
    if not (0 < fx < np.inf and 0 < fy < np.inf and np.isfinite([cx, cy]).all()):
        raise WrongCameraInfo(
            f'camera_info has no usable intrinsics: fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}'
        )
    size = f'{_extent(info)[0]}x{_extent(info)[1]}'
    raise WrongCameraInfo(
        f'camera_info has a K that sees {_view(info, fx, fy, cx, cy):.1f} deg of {size} pixels: '
        f'fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}'
    )


def _sees(matrix: Any, places: tuple[int, ...], info: Any) -> bool:
    """Whether a matrix is that of a pinhole camera."""
    fx, fy, cx, cy = (float(matrix[i]) for i in places)
    usual = 0 < fx < 1 / FINEST_RAD and 0 < fy < 1 / FINEST_RAD and bool(np.isfinite([cx, cy]).all())
    return usual and _view(info, fx, fy, cx, cy) <= WIDEST_DEG


def _view(info: Any, fx: float, fy: float, cx: float, cy: float) -> float:
    """Angle of view, degrees, to both sides of the axis as far as to the farther one."""
    width, height = _extent(info)  # the centre of the first pixel is at zero
    left, top = int(info.roi.x_offset) - 0.5, int(info.roi.y_offset) - 0.5
    aside = max(abs(left - cx), abs(left + width - cx)) / fx
    above = max(abs(top - cy), abs(top + height - cy)) / fy
    return 2 * math.degrees(math.atan(max(aside, above)))


def _extent(info: Any) -> tuple[int, int]:
    return int(info.roi.width or info.width), int(info.roi.height or info.height)


def _distortion(info: Any) -> Distortion | None:
    try:
        return Distortion.of(str(info.distortion_model), info.d)
    except ValueError as error:
        raise WrongCameraInfo(f'camera_info: {error}') from None
