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

"""The set of key frames: their poses, their views in bounded memory, and which of them look from where.

A prepared view of 250 x 150 pixels takes 1.1 MB, its compressed depth 12 kB. So only the most recently used
views stay prepared; of the others the depth alone is kept. Preparing a view anew takes some three
milliseconds. It is the same view, to the bit, where the camera measures in full millimetres, else to a tenth
of a millimetre.
"""

from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import overload

import numpy as np

from debris_scanner.core.frames import KeyFrame, KeyPose, LazyFrames, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import PackedFrame
from debris_scanner.sensing.views import View

PREPARED = 64  # views a set keeps prepared, 70 to 130 MB: the visible side and its neighbours


class ViewCache(Sequence[View]):
    """A list of views, of which at most ``capacity`` are prepared at a time.

    Args:
        capacity: at least one.
        settings: to fit the normals of a view that is prepared anew.
    """

    def __init__(self, capacity: int, settings: NormalSettings) -> None:
        self.capacity = capacity
        self.centroids: list[Array] = []  # of all views, (3,), view frame
        self.resolutions: list[float] = []  # m, of all views
        self.extents: list[float] = []  # m, along the longest axis of the view frame, of all views
        self.settings = settings
        self._packed: list[PackedFrame | None] = []  # None: not packed so far
        self._unoccluded: list[bool] = []
        self._offset = NO_OFFSET
        self._prepared: OrderedDict[int, View] = OrderedDict()  # least recently used first

    def __len__(self) -> int:
        return len(self._packed)

    def append(self, view: View) -> None:
        """Append a view, free from the offset."""
        self.centroids.append(view.centroid)
        self.resolutions.append(view.resolution)
        self.extents.append(float(np.ptp(view.points, axis=0).max()))
        self._packed.append(None)
        self._unoccluded.append(view.unoccluded)
        self._keep(len(self._packed) - 1, view)

    def append_from(self, other: 'ViewCache', index: int) -> None:
        """Append a view of another list as it is kept there, prepared or not."""
        self.centroids.append(other.centroids[index])
        self.resolutions.append(other.resolutions[index])
        self.extents.append(other.extents[index])
        self._packed.append(other._packed[index])
        self._unoccluded.append(other._unoccluded[index])
        if index in other._prepared:
            self._keep(len(self._packed) - 1, other._prepared[index])

    @overload
    def __getitem__(self, index: int) -> View: ...

    @overload
    def __getitem__(self, index: slice) -> list[View]: ...

    def __getitem__(self, index: int | slice) -> View | list[View]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = range(len(self))[index]  # raises as a list does
        view = self._prepared.get(k)
        if view is None:
            view = View(self.frame(k))
            view.unoccluded = self._unoccluded[k]
        self._keep(k, view)
        return view

    @property
    def offset(self) -> DepthOffset:
        """What the sensor does to its images, as far as is known; the views are free from it."""
        return self._offset

    @offset.setter
    def offset(self, offset: DepthOffset) -> None:
        for k, view in self._prepared.items():
            self._packed[k] = self._packed[k] or PackedFrame(view.frame)
        self._prepared.clear()
        self._offset = offset

    def prepare(self, frame: TargetFrame) -> View:
        """A view of a frame, free from the offset."""
        return View(self._offset.freed(frame, self.settings))

    def is_unoccluded(self, index: int) -> bool:
        """Whether a view is unoccluded, as far as is known."""
        return self._unoccluded[index]

    def set_unoccluded(self, index: int, unoccluded: bool) -> None:
        """Set whether a view is unoccluded."""
        self._unoccluded[index] = unoccluded
        if index in self._prepared:
            self._prepared[index].unoccluded = unoccluded

    def frame(self, index: int) -> TargetFrame:
        """The frame of a view, free from the offset; prepares no view."""
        if index in self._prepared:
            return self._prepared[index].frame
        packed = self._packed[index]
        assert packed is not None
        return packed.restore(self.settings, self._offset)

    @contextmanager
    def all_prepared(self) -> Iterator[None]:
        """Inside this context every view stays prepared once it was asked for."""
        capacity, self.capacity = self.capacity, max(self.capacity, len(self))
        try:
            yield
        finally:
            self.capacity = capacity
            self._pack_oldest()

    def rest(self) -> None:
        """Keep no view prepared: nobody asks for them for a while."""
        capacity, self.capacity = self.capacity, 0
        self._pack_oldest()
        self.capacity = capacity

    def _keep(self, k: int, view: View) -> None:
        self._prepared[k] = view
        self._prepared.move_to_end(k)
        self._pack_oldest()

    def _pack_oldest(self) -> None:
        while len(self._prepared) > self.capacity:
            old, evicted = self._prepared.popitem(last=False)
            self._packed[old] = self._packed[old] or PackedFrame(evicted.frame)


class KeyFrameSet:
    """Key frames in order of time, each with its view; looked up by stamp, index or view angle.

    Args:
        normals: settings with which views are prepared anew.
        prepared: number of views kept prepared; None takes ``PREPARED``.
    """

    def __init__(self, normals: NormalSettings, prepared: int | None = None) -> None:
        self.frames: list[KeyPose] = []
        self.views = ViewCache(prepared or PREPARED, normals)
        self.index: dict[int, int] = {}  # by stamp
        self._latest = 0  # submap of the newest key frame
        self._coloured: list[int] = []

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, keyframe: KeyFrame, view: View | None = None) -> None:
        """Append a key frame with a pose of its own; its view is prepared here if none is given."""
        k = self.index[keyframe.stamp_ns] = len(self.frames)
        linked = k > 0 and keyframe.submap == self._latest
        T_previous = None
        if linked:
            T_previous = compose(inverse(self.frames[-1].T_target_sensor), keyframe.T_target_sensor)
        # the previous submap may have been joined to another, whose target frame differs
        self.frames.append(
            KeyPose(
                keyframe.stamp_ns,
                keyframe.T_target_sensor,
                keyframe.path_rad,
                submap=keyframe.submap,
                original_submap=keyframe.submap,
                linked=linked,
                T_previous=T_previous,
            )
        )
        self._latest = keyframe.submap
        self.views.append(view or self.views.prepare(keyframe.frame))
        if keyframe.frame.rgb is not None:
            self._coloured.append(k)

    def interleaved(self, more: Sequence[KeyFrame], linked: Sequence[bool]) -> 'KeyFrameSet':
        """A set with further key frames among these, in order of time.

        Args:
            more: in order of time, posed in the active target frame; their views are prepared here.
            linked: whether each was tracked on from the key frame before it.
        """
        other = KeyFrameSet(self.views.settings, max(self.views.capacity, len(self) + len(more)))
        other.views.offset = self.views.offset
        other._latest = self._latest
        places = {k.stamp_ns: n for n, k in enumerate(more)}
        for stamp_ns in sorted([*self.index, *places]):
            before = other.frames[-1] if other.frames else None
            if stamp_ns in places:
                n = places[stamp_ns]
                keyframe = more[n]
                pose = KeyPose(
                    stamp_ns,
                    keyframe.T_target_sensor,
                    keyframe.path_rad,
                    submap=self._latest,
                    original_submap=keyframe.submap,
                    linked=before is not None and linked[n],
                    added=True,
                )
                other.views.append(other.views.prepare(keyframe.frame))
            else:
                k = self.index[stamp_ns]
                pose = replace(self.frames[k])
                other.views.append_from(self.views, k)
                if k in self._coloured:
                    other._coloured.append(len(other.frames))
            new_step = stamp_ns in places or (before is not None and before.stamp_ns in places)
            if before is not None and pose.linked and new_step:
                pose.T_previous = compose(inverse(before.T_target_sensor), pose.T_target_sensor)
            other.index[stamp_ns] = len(other.frames)
            other.frames.append(pose)
        other.views.capacity = self.views.capacity
        return other

    @property
    def active(self) -> list[int]:
        """Indices of the key frames whose poses can be compared with the newest one's."""
        return [k for k, frame in enumerate(self.frames) if frame.submap == self._latest]

    def join(self, earlier_ns: int, later_ns: int, T_earlier_later: Array) -> None:
        """Merge the submaps of two key frames; the active target frame stays, or else the later one's.

        Args:
            earlier_ns: stamp of the earlier key frame.
            later_ns: stamp of the later key frame.
            T_earlier_later: pose (4, 4) of the later in the earlier.

        Raises:
            ValueError: one of the key frames is unknown.
        """
        if earlier_ns not in self.index or later_ns not in self.index:
            raise ValueError(f'no closure possible between frames {earlier_ns} and {later_ns}')
        moved, held = self.frames[self.index[earlier_ns]], self.frames[self.index[later_ns]]
        T_moved_held = T_earlier_later
        if moved.submap == self._latest:
            moved, held, T_moved_held = held, moved, inverse(T_earlier_later)
        submap = moved.submap
        if submap == held.submap:
            return
        T = compose(held.T_target_sensor, inverse(T_moved_held), inverse(moved.T_target_sensor))
        for frame in self.frames:
            if frame.submap == submap:
                frame.submap = held.submap
                frame.T_target_sensor = compose(T, frame.T_target_sensor)

    def part(self, stamps_ns: Collection[int]) -> bool:
        """Undo the joining of the submaps that these key frames came in; whether any had been joined."""
        known = [self.frames[self.index[stamp]] for stamp in stamps_ns]
        apart = {f.original_submap for f in known if f.original_submap != f.submap}
        for frame in self.frames:
            if frame.original_submap in apart:
                frame.submap = frame.original_submap
        return bool(apart)

    @property
    def joined(self) -> bool:
        """Whether the active key frames came in several submaps."""
        return any(self.frames[k].original_submap != self._latest for k in self.active)

    @property
    def posed(self) -> LazyFrames[int]:
        """Active frames usable for mapping, with their current poses."""
        usable = [k for k in self.active if self.frames[k].usable_for_mapping]
        return LazyFrames(usable, lambda k: (self.views.frame(k), self.frames[k].T_target_sensor))

    @property
    def has_colour(self) -> bool:
        """Whether any key frame has."""
        return bool(self._coloured)

    def coloured(self) -> Iterator[KeyFrame]:
        """Active key frames with colour, restored one by one."""
        for k in self._coloured:
            pose = self.frames[k]
            if pose.submap == self._latest:
                yield KeyFrame(self.views.frame(k), pose.T_target_sensor, pose.path_rad)

    @property
    def centre(self) -> Array:
        """Centre (3,) of the target: mean of the active views' centroids, target frame."""
        active = self.active
        T = np.array([self.frames[k].T_target_sensor for k in active])
        seen = np.array([self.views.centroids[k] for k in active])
        return np.asarray((np.einsum('nij,nj->ni', T[:, :3, :3], seen) + T[:, :3, 3]).mean(axis=0))

    @property
    def resolution(self) -> float:
        """Median of what the views resolve, m."""
        return float(np.median(self.views.resolutions))

    def view_angles(self, T_target_sensor: Array, centre: Array) -> Array:
        """Angle (n,), radians, between each key frame's direction of view onto the centre and that of a pose.

        It is infinite for key frames that are not active: their pose relative to the others is unknown.

        Args:
            T_target_sensor: (4, 4).
            centre: (3,), target frame.
        """
        eyes = np.array([k.T_target_sensor[:3, 3] for k in self.frames]).reshape(-1, 3) - centre
        eye = T_target_sensor[:3, 3] - centre
        cosine = eyes @ eye / (np.linalg.norm(eyes, axis=1) * np.linalg.norm(eye))
        angles = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.where([k.submap == self._latest for k in self.frames], angles, np.inf)

    def move(self, poses: dict[int, Array], T_new_old: Array) -> None:
        """Set optimised poses T_target_sensor by stamp; all other poses move by T_new_old."""
        for keyframe in self.frames:
            moved = poses.get(keyframe.stamp_ns)
            keyframe.T_target_sensor = (
                compose(T_new_old, keyframe.T_target_sensor) if moved is None else moved
            )
