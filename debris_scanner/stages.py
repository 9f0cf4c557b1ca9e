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

"""The stages of a scanner, made from its settings; a node loads no more than its own needs."""

from debris_scanner.core.frames import Model
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import ClosureDetector
from debris_scanner.modelling.generation import ModelSettings
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.settings import Settings
from debris_scanner.tracking.gating import STRICT
from debris_scanner.tracking.odometry import Odometry


def make_odometry(settings: Settings, timer: StageTimer | None = None) -> Odometry:
    """The odometry stage of a scanner with these settings."""
    return Odometry(settings.odometry, settings.motion, settings.normals, timer)


def make_preprocessor(settings: Settings, timer: StageTimer | None = None) -> Preprocessor:
    """The preprocessing stage."""
    return Preprocessor(settings.isolation, settings.normals, timer)


def make_closure_detector(settings: Settings, timer: StageTimer | None = None) -> ClosureDetector:
    """The closure detection stage."""
    s = settings
    return ClosureDetector(s.closure, s.closure_search, s.descriptor, s.verification, s.normals, timer)


def make_model_builder(
    settings: Settings, timer: StageTimer | None = None, model: Model | None = None
) -> ModelBuilder:
    """The pose graph and model stage; a model known beforehand is looked for."""
    s = settings
    loss = s.odometry.max_loss
    chosen = ModelSettings(s.builder, s.fusion, s.verdict, s.normals, s.motion, loss)
    builder = ModelBuilder(chosen, s.pose_graph, timer)
    if model is not None:
        builder.know(model, STRICT * loss)
    return builder
