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

"""Mapping: the key frames of a scan, the loops they close, and their relaxed poses.

A key frame enters a ``keyframes.KeyFrameSet``, which keeps its pose and view. ``descriptors`` describes the
view, ``closure_search`` ranks the earlier key frames by the probability that they show the same face, and the
``closures.ClosureDetector`` verifies the best by geometry. ``submap_closures`` does the same between submaps,
whose relative pose is unknown, and merges those that fit; ``bridging`` tells equal faces apart by the motion.

``pose_graph`` takes key frames and accepted closures. ``frame_graph`` prunes it to the key frames on
cycles, and ``optimiser`` relaxes these, then all pairs (``relaxation``); ``motion_prior`` bridges views that
tell little, and tells where the rate jumps. ``self_calibration`` finds what the sensor does to its images,
with the poses. ``occluded_views`` are those that others show to be half hidden. ``evidence`` measures the
sensor's noise on neighbours; ``closure_matrices`` compares all pairs for plots.
"""
