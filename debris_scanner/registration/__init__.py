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

"""How well two views of the target agree, and the motion that makes them agree better.

1. `kernels` projects the points of one view into the image of the other. It adds point-to-plane terms, rim
   terms and counts of evidence: matches, free-space and silhouette violations, occlusions.
2. `projective.linearise` turns them into normal equations for a twist, with `RegistrationStats`.
3. `projective.register` repeats that by Gauss-Newton over shrinking gates.
4. `picture_terms` adds what the colours of two views say, where both have any.
5. `projective.rotation_observability` tests whether the target's rotation can be observed at all.

Odometry, closures and the pose graph all use this one linearisation. `likelihood` says how well two posed
views agree, in nats a point: the gates of frames and closures and the verdict ask it. `offset_terms` says
what an error of the depth that stays in the image does to the residuals.
"""

from debris_scanner.registration.projective import RegistrationStats, linearise, register

__all__ = ['RegistrationStats', 'linearise', 'register']
