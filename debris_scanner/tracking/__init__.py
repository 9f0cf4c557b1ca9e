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

"""The pose and motion of the target, frame by frame, while it is scanned and once a model is tracked.

``odometry.Odometry`` takes each frame through these steps:

1. predict: the ``motion_filter.MotionFilter`` propagates pose, rates and accelerations to the frame's stamp.
2. register: the ``local_map.LocalMap`` chooses the references (``submaps``), and fits the frame to all of
   them inside the filter (``gating``).
3. gate: the fit is accepted or rejected; after several rejected frames the target is lost.
4. relocalize: ``pose_search`` fits a rejected frame from many attitudes around the prediction, later from
   all; the ``relocalizer.Relocalizer`` follows several hypotheses until one is left.
5. update: the accepted fit becomes the state, and ``occlusion`` notes whether the frame shows the whole side.
6. key frame: ``submaps`` makes an unoccluded frame one when the target has turned far enough.

At the end ``dynamics`` fits a torque-free body to the final poses, for the mass properties, and ``forecast``
tells how it goes on; live, while a model is tracked, again and again.
"""
