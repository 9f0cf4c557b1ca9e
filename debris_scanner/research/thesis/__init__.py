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

"""The published method, step by step as it was: Trowbridge 2014, with its errata corrected.

``odometry`` aligns each frame to the one before (``frame_registration``) and estimates attitude and rate
(``attitude_ekf`` or ``batch_processor``, both in ``euler_parameters``). ``loop_closures`` finds closures and
prunes the frame graph. ``network`` relaxes it (``elch`` or ``lum``; ``spring_stability`` predicts whether it
converges), and ``refiner`` makes the model (``moving_least_squares``). ``pipeline`` runs all of it.

Every step is selectable beside the product's own method and shares its types (TargetFrame, Model,
StampedPose); nothing here is used by the scanner itself.
"""
