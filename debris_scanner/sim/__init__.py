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

"""Simulated recordings of a rotating target, every frame with its true pose.

1. `targets` builds the target from `shapes`, or reads a mesh file, and paints it; `clutter` adds
   still objects around it, and a hand.
2. `motions` gives the true pose over time: spins, a swing, a relative orbit, a torque-free `tumble`. `gaps`
   hides the target for seconds, or a part of it.
3. `depth_sensor` casts `rays` at the `surface` and adds a Kinect's noise and drop-out, and on request the
   drop-out of shiny `insulation`.
4. `sensors` has a record for each other sensor: geometry, noise law, fixed patterns, what it misses.
   `modelled_sensor` renders by such a record; `image_filters` does what a driver does afterwards.
5. `session` puts these together and writes the truth beside the recording.

Equal settings give equal frames, bit for bit.
"""
