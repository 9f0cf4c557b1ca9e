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

"""What attempts at a model go by, and what comes of one."""

from collections.abc import Callable
from dataclasses import dataclass

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import parameter
from debris_scanner.core.results import Checks
from debris_scanner.mapping.optimiser import Optimised
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.validation import VerdictSettings
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.motion_filter import MotionSettings

Progress = Callable[[str, int, int], None]  # what, done, of how many


@dataclass(frozen=True)
class BuilderSettings:
    """When a model is generated, and how many frames may be kept for it."""

    kept_frames: int = parameter(1000, 'frames whose depth is kept for fusion', '', 10, 10**6)
    growth: float = parameter(
        0.25, 'new key frames, as a share, that call for a better model', '', 0.01, 10.0
    )


@dataclass
class ModelSettings:
    """What attempts at a model go by; some of it may change during a scan."""

    builder: BuilderSettings
    fusion: FusionSettings
    verdict: VerdictSettings
    normals: NormalSettings
    motion: MotionSettings
    accepted_loss: float  # nats a point, of a frame that odometry takes


@dataclass(frozen=True)
class Generation:
    """Outcome of one attempt: a model with the poses it was made from, or the reason why not."""

    model: Model | None
    reason: str | None
    why: str
    poses: dict[int, Array]  # T_target_sensor of the key frames by stamp, model's target frame
    optimised: Optimised | None
    withdrawn: bool = False  # the known model that was tracked so far is given up
    checks: Checks = ()  # that decided
    offset: DepthOffset = NO_OFFSET  # of the sensor, that model and poses are free from
