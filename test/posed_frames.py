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

"""Frames of simulated targets at their true poses."""

import numpy as np

from debris_scanner.core.frames import DepthFrame, FrameRejected, KeyFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.mapping.evidence import sensor_evidence
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor


def tumbling(target, **options):
    """Target frames of a tumble and T_target_sensor; options as of :func:`simulated`."""
    settings = SimulationSettings(target=target, motion='tumble', seconds=60.0, rate_hz=1.5)
    return simulated(settings, **options)


def simulated(settings, target=None, seen=lambda frame: frame):
    """Target frames of a recording, as ``seen`` makes of each depth frame, and T_target_sensor."""
    preprocessor = make_preprocessor(Settings())
    frames = []
    for f in Simulation(settings, target):
        frame = DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera, f.picture)
        try:
            isolated = preprocessor.process(seen(frame))
        except FrameRejected:  # still finding out what the target is
            continue
        frames.append((isolated, inverse(f.T_sensor_target)))
    return frames


def posed_views(frames):
    """Posed views of target frames with their T_target_sensor; the sensor is measured on them."""
    keyframes = KeyFrameSet(NormalSettings())
    for frame, T in frames:
        keyframes.add(KeyFrame(frame, T, 0.0))
    views = keyframes.views[:]
    return PosedViews(views, [T for _, T in frames], sensor_evidence(keyframes))
