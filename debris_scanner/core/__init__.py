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

"""What all rooms share: a frame's data, its camera, its geometry and its time. Depends on no other room.

A cloud or a depth image enters as a `frames.DepthFrame`: depth with its pinhole `Camera`. The stages turn it
into a `TargetFrame`, some of these into a `KeyFrame`, and all together into a `Model`. `results` holds what a
finished scan leaves.

`geometry` computes rotations and rigid transforms, `turn` how much of a turn was shown. `voxel_grid` thins
clouds, `atlas` lays meshes flat. `stamps` keeps frames in order of time and pairs streams. `parameters`
declares settings once and reads them from YAML. `timing` and `memory` watch the process.
"""
