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

"""Settings of the odometry: key frames, references, and when a frame is believed."""

from dataclasses import dataclass

from debris_scanner.parameters import parameter


@dataclass(frozen=True)
class OdometrySettings:
    """Key frames, references, and when a frame is believed."""

    keyframe_angle_deg: float = parameter(6.0, 'turn of the target between key frames', 'deg', 0.5, 45.0)
    max_keyframes: int = parameter(
        600,
        'key frames of a scan; from then on none is added, and frames are registered to those most alike',
        '',
        10,
        10**5,
    )
    recent_keyframes: int = parameter(4, 'key frames a frame is registered to', '', 1, 20)
    tracked_keyframes: int = parameter(
        2, 'key frames most alike that a frame is registered to beside the model', '', 0, 20
    )
    min_share: float = parameter(
        0.4, 'a search needs this share of the surface points that its key frames show', '', 0.0, 1.0
    )
    gate_sigma: float = parameter(
        4.0,
        'a search may find attitudes this far from the prediction',
        'sigma',
        0.1,
        100.0,
    )
    max_uncertainty_deg: float = parameter(
        30.0, 'until it is this uncertain, 1 sigma; then any that a model explains', 'deg', 1.0, 180.0
    )
    search_period: float = parameter(
        0.5, 'while lost, time between searches of all attitudes', 's', 0.0, 60.0
    )
    reference_angle_deg: float = parameter(
        40.0, 'key frames seen from further away are no reference', 'deg', 5.0, 90.0
    )
    min_points: int = parameter(150, 'fewer sampled surface points are no frame', '', 20, 10**5)
    min_overlap: float = parameter(0.6, 'share of the points that must match', '', 0.0, 1.0)
    max_rms: float = parameter(0.0029, 'largest residual of the matched points', 'm', 1e-5, 0.1)
    max_free_space: float = parameter(0.10, 'largest share of points in seen free space', '', 0.0, 1.0)
    max_outside: float = parameter(0.25, 'largest share of points beside the silhouette', '', 0.0, 1.0)
    max_keyframe_missing: float = parameter(
        0.05, 'and of a key frame, which is to show the whole side', '', 0.0, 1.0
    )
    max_missing: float = parameter(
        0.6, "largest share of the reference's points beside the frame's silhouette", '', 0.0, 1.0
    )
    max_found_missing: float = parameter(0.15, 'and of a frame that a search found', '', 0.0, 1.0)
    lost_after: int = parameter(3, 'disbelieved frames in a row until the target is lost', '', 1, 1000)
    max_gap: float = parameter(0.35, 'a longer gap is searched, not just predicted', 's', 0.01, 60.0)

    def full(self, keyframes: int) -> str:
        """Why a scan of so many key frames gets no more, in words; empty while it may."""
        if keyframes < self.max_keyframes:
            return ''
        return f'{keyframes} key frames, the most of a scan (odometry.max_keyframes): none is added any more'
