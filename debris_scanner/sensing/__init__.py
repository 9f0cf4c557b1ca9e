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

"""From a depth frame to the target alone, ready for registration.

1. `isolation` keeps the points in the box, clusters them and selects the target; still ones are clutter. It
   learns once what the target stands on, by the planes that `support` fits.
2. `preprocessing` crops the image to the target.
3. `normals` fits a plane around each pixel, in disparity, also through the pores of shiny insulation.
4. `silhouette` and `rim` find where the target ends in the image, and which of that are its own edges.
5. `picture` makes of the colours what no lamp changes, where the input has any.
6. `views` samples points and builds the maps that registration looks up.

`sensor_model` measures the noise on neighbouring key frames, picked by `mapping.evidence`, for the verdict.
`depth_offset` is an error of the depth that stays in the image, and frees frames from it.
`packing` stores frames compactly; their planes are fitted again on reading.
"""
