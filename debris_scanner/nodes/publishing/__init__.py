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

"""The topics on which nodes publish results, and how other nodes read them back.

``estimates`` converts an odometry estimate to messages and back. The three publishers own their topics:
``odometry_publisher`` pose, status, key frames and TF; ``closure_publisher`` hypotheses and accepted
closures; ``model_publisher`` model, mesh, key-frame poses and markers.
"""
