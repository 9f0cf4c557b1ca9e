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

"""Modelling: from key frames, closures and accepted frames to a validated model.

``model_builder`` drives the steps. ``frame_store`` keeps the frames and a bounded number of depths.

1. The pose graph is optimised (:mod:`debris_scanner.mapping`); ``rivals`` are poses that may agree better.
2. ``validation`` gives the verdict on the posed key frames, published or refused with a reason: do they agree
   (``consistency``), and can the rotation be observed (``ambiguity``)?
3. ``refinement`` registers the frames to their key frames, and ``fusion`` integrates them into a signed
   distance field, of which ``fusion.FusedSurface`` is the zero level.
4. ``closing`` closes the last one where nobody looked; ``coverage`` and ``solid`` tell of it.
5. ``texture`` lays an image around the closed surface where key frames have colour.
6. ``refinement`` makes cloud, mesh and colour of them.

``symmetry`` looks for rotations that leave the finished model as it is.
"""
