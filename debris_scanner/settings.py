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

"""All parameters of the scanner in one tree, as params/default.yaml and the ROS nodes show them."""

from dataclasses import dataclass, field

from debris_scanner.closure_search import ClosureSearchSettings
from debris_scanner.closures import ClosureSettings
from debris_scanner.efpfh import DescriptorSettings
from debris_scanner.fusion import FusionSettings
from debris_scanner.isolation import IsolationSettings
from debris_scanner.model_builder import BuilderSettings
from debris_scanner.motion_filter import MotionSettings
from debris_scanner.normals import NormalSettings
from debris_scanner.odometry_settings import OdometrySettings
from debris_scanner.pose_graph import PoseGraphSettings
from debris_scanner.verdict import VerdictSettings
from debris_scanner.verification import VerificationSettings


@dataclass(frozen=True)
class Settings:
    """One group an algorithm; the names are those of the groups in the parameter file."""

    isolation: IsolationSettings = field(default_factory=IsolationSettings)
    normals: NormalSettings = field(default_factory=NormalSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)
    descriptor: DescriptorSettings = field(default_factory=DescriptorSettings)
    closure_search: ClosureSearchSettings = field(default_factory=ClosureSearchSettings)
    closure: ClosureSettings = field(default_factory=ClosureSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)
    pose_graph: PoseGraphSettings = field(default_factory=PoseGraphSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)
    builder: BuilderSettings = field(default_factory=BuilderSettings)
