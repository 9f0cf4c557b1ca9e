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

"""Depth frames of the messages of one input: its unit, its lens, its axes, and remarks on them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, transform
from debris_scanner.sensing.cloud_axes import BODY, OPTICAL, camera_axes, lies_along, parse_axes
from msg_adapters.clouds import read_cloud
from msg_adapters.depth_images import read_depth
from msg_adapters.errors import DuplicateFrame, NotOptical
from msg_adapters.inputs.camera_infos import Lens, read_lens
from msg_adapters.inputs.compressed import decompressed
from msg_adapters.inputs.static_frames import OPTICAL_WORD, StaticFrames
from msg_adapters.stamps import frame_stamp

COMPRESSED = 'sensor_msgs/msg/CompressedImage'


@dataclass(frozen=True)
class InputOptions:
    """What a user knows of an input.

    ``depth_scale`` is metres a unit of depth; 0: as the format says, 0.001 of 16 bit and 1 of floats.
    ``axes`` are those of clouds, for :func:`~debris_scanner.sensing.cloud_axes.parse_axes`; '': found out.
    """

    depth_scale: float = 0.0
    axes: str = ''


class FrameDecoder:
    """Makes depth frames of an input's messages.

    Args:
        options: what the user says.
        frames: the frames that do not move; the caller may add to them.

    Raises:
        ValueError: the axes are none.
    """

    def __init__(self, options: InputOptions | None = None, frames: StaticFrames | None = None) -> None:
        self.options = options or InputOptions()
        self.frames = frames or StaticFrames()
        self.remarks: list[str] = []  # lines that the user should read, each once; the caller takes them
        self.unit = 0.0  # metres a unit of 16-bit depth, where the recording says so; 0: it does not
        self._T_given = parse_axes(self.options.axes) if self.options.axes else None
        self._said: set[str] = set()
        self._placements: dict[str, Array] = {}  # T_optical_cloud by frame id
        self._lens: tuple[Any, Lens] | None = None  # with what it was read from
        self._last: tuple[int, NDArray[np.float32]] | None = None  # stamp and depth

    def image(
        self, image: Any, info: Any, rgb: NDArray[np.uint8] | None = None, rectified: bool = False
    ) -> DepthFrame:
        """Frame of a depth Image or CompressedImage with its CameraInfo, and colours (h, w, 3) of its pixels.

        Colours of another size are left out.

        Raises:
            MalformedMessage: the image contradicts itself.
            DuplicateFrame: its depth is that of the last image.
            WrongCameraInfo: no camera's, or not this image's.
        """
        if not hasattr(image, 'encoding'):
            image = decompressed(image)
        stamp_ns = frame_stamp(image.header.stamp)
        depth = read_depth(image, self.options.depth_scale or self.unit)
        lens = self._lens_of(info, (depth.shape[1], depth.shape[0]), rectified)
        depth = self._new(stamp_ns, depth)
        if rgb is not None and rgb.shape[:2] != depth.shape:
            rgb = None
        if lens.rectifier is not None:
            depth = lens.rectifier.depth(depth)
            rgb = None if rgb is None else lens.rectifier.colour(rgb)
        return DepthFrame(stamp_ns, depth, lens.camera, rgb)

    def cloud(self, message: Any) -> DepthFrame:
        """Frame of a PointCloud2; see ``DepthFrame.from_cloud`` for clouds that no camera explains.

        Raises:
            MalformedMessage: the cloud contradicts itself.
            NotOptical: it lies in no optical frame, and nothing tells how it lies.
        """
        cloud = read_cloud(message)
        with np.errstate(all='ignore'):  # coordinates may be as wild as the sender's bytes
            points = cloud.xyz
            if self.options.depth_scale:
                points = points * np.float32(self.options.depth_scale)
            T = self._placement(cloud.frame_id, points)
            if T is not None:
                points = points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
            frame = DepthFrame.from_cloud(cloud.stamp_ns, points, cloud.rgb)
        self._new(frame.stamp_ns, frame.depth)
        return frame

    def restart(self) -> None:
        """Begin anew: what comes next is no duplicate of what came last."""
        self._last = None

    def forget_frames(self) -> None:
        """Find the axes of clouds anew, after transforms were added."""
        self._placements.clear()

    def _new(self, stamp_ns: int, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """The depth, if it is not that of the last frame bit for bit: no sensor measures the same twice.

        Recorders poll faster than a sensor measures, and drivers repeat its image when one is late.
        """
        last, self._last = self._last, (stamp_ns, depth)
        if last is None or last[1].shape != depth.shape or stamp_ns <= last[0]:
            return depth
        thin = (slice(None, None, 16),) * 2
        if np.array_equal(last[1][thin], depth[thin]) and np.array_equal(last[1], depth) and depth.any():
            raise DuplicateFrame('the depth is that of the frame before, bit for bit: it was sent twice')
        return depth

    def _lens_of(self, info: Any, size: tuple[int, int], rectified: bool) -> Lens:
        """The lens of a CameraInfo, kept as long as its content stays."""
        roi = info.roi
        key = (
            *(tuple(map(float, numbers)) for numbers in (info.k, info.p, info.d)),
            (str(info.distortion_model), int(info.width), int(info.height), *size, rectified),
            (int(info.binning_x), int(info.binning_y)),
            tuple(int(n) for n in (roi.x_offset, roi.y_offset, roi.width, roi.height)),
        )
        if self._lens is None or self._lens[0] != key:
            self._lens = key, read_lens(info, *size, rectified)
            self.restart()
        return self._lens[1]

    def _placement(self, frame_id: str, points: NDArray[np.float32]) -> Array | None:
        """T_optical_cloud (4, 4) of a frame; None: it is optical."""
        T = self._T_given
        if T is None:
            T = self._placements.get(frame_id)
        if T is None:
            T, how = self._found(frame_id, points)
            moved = points if how is None else points @ T[:3, :3].T.astype(np.float32)
            if lies_along(moved):
                raise NotOptical(
                    f'points of frame {frame_id!r} lie along {lies_along(points) or "+z"}: not an optical '
                    'frame (x right, y down, z forward); give their axes (--axes, parameter axes) or '
                    '/tf_static'
                )
            self._placements[frame_id] = T
            self._say(f'clouds of frame {frame_id!r} are turned to the optical frame: {how}' if how else '')
        return None if T is _OPTICAL else T

    def _found(self, frame_id: str, points: NDArray[np.float32]) -> tuple[Array, str | None]:
        """T_optical_cloud by what tells it: the frame's name, transforms, the image that it is; and which."""
        if OPTICAL_WORD in frame_id:
            return _OPTICAL, None
        if (linked := self.frames.optical(frame_id)) is not None:
            return linked[1], f'/tf_static links it with {linked[0]}'
        seen = camera_axes(points) if points.ndim == 3 else None
        if seen is BODY:
            return _BODY, 'it is the image of a camera that looks along +x'
        if seen is not OPTICAL and frame_id.endswith('link'):
            return _BODY, 'its name is that of a body frame (x forward, REP-103)'
        return _OPTICAL, None

    def _say(self, remark: str) -> None:
        if remark and remark not in self._said:
            self._said.add(remark)
            self.remarks.append(remark)


_OPTICAL, _BODY = transform(OPTICAL, np.zeros(3)), transform(BODY, np.zeros(3))
