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

"""Could frames as well have been taken of the target turned by a part of a full turn?

Where submaps were joined by their looks alone, nothing else tells such a turn from none: of a box that was
lost and found again it can't be known which of its like sides was seen before.
"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.evidence import FrameEvidence, model_evidence
from debris_scanner.frames import TargetFrame
from debris_scanner.fusion import FusedSurface
from debris_scanner.geometry import Array, apply
from debris_scanner.symmetry import turns_onto_itself

ALIKE = 0.5  # of the surface meets itself: worth asking the frames, of which some parts were never seen
EXPLAINED = 0.03  # less of the surface in view may match once it is turned,
CONTRADICTED = 0.01  # more of it lie where nothing was seen: means over the frames;
DRAWN = np.radians(1.3)  # and by so much more may it draw them to another attitude (90th percentile)


def looks_alike_turned(fused: FusedSurface, frames: Sequence[tuple[TargetFrame, Array]]) -> bool:
    """Whether a surface, turned, explains the frames (posed T_target_sensor) it was made from as well."""
    own = _figures(model_evidence(fused, frames))
    for _, T, share in turns_onto_itself(fused.vertices, fused.normals):
        if share < ALIKE:
            continue
        vertices, normals = apply(T, fused.vertices), fused.normals @ T[:3, :3].T
        turned = FusedSurface(vertices.astype(np.float32), normals.astype(np.float32), fused.triangles)
        explained, contradicted, drawn = _figures(model_evidence(turned, frames))
        if explained > own[0] - EXPLAINED and contradicted < own[1] + CONTRADICTED and drawn < own[2] + DRAWN:
            return True
    return False


def _figures(evidence: Sequence[FrameEvidence]) -> tuple[float, float, float]:
    agreements = [e.agreement for e in evidence]
    explained = np.mean([a.explained for a in agreements])
    contradicted = np.mean([a.free_space + a.outside for a in agreements])
    return float(explained), float(contradicted), float(np.percentile([e.turn for e in evidence], 90))
