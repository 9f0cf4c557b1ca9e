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

"""All parameters of the scanner in one tree, and their parameter file.

``params/default.yaml`` lists every parameter with its default, description, unit and range. It is the output
of ``python -m debris_scanner.settings``, as a test checks.
"""

import dataclasses
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar

from debris_scanner.core.parameters import flatten, load, updated
from debris_scanner.mapping.closure_search import ClosureSearchSettings
from debris_scanner.mapping.closures import ClosureSettings, VerificationSettings
from debris_scanner.mapping.descriptors import DescriptorSettings
from debris_scanner.mapping.pose_graph import PoseGraphSettings
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.model_builder import BuilderSettings
from debris_scanner.modelling.validation import VerdictSettings
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.motion_filter import MotionSettings


@dataclass(frozen=True)
class Settings:
    """The settings of each algorithm; their names are those of the groups in the parameter file."""

    # parameters of earlier releases: the new name, empty for a removed one
    RENAMED: ClassVar[Mapping[str, str]] = {
        'closure_search.min_probability': '',
        'closure_search.min_turn': '',
        'closure_search.preceding': '',
        'closure.accepted_angle_deg': '',
        'closure.patience': '',
        'verification.max_turn_deg': '',
        'verification.max_drift': '',
        'odometry.max_free_space': '',
        'odometry.max_outside': '',
        'odometry.max_missing': '',
        'odometry.max_missing_reference': '',
        'odometry.max_gap': 'odometry.lost_after',
        'odometry.search_period': '',
        'odometry.min_points': '',
        'isolation.min_part_pixels': 'isolation.min_pixels',
        'isolation.margin': '',
        'normals.inner_radius': 'normals.radius',
        'normals.max_jump': 'normals.radius',
        'motion.centre_depth': 'motion.centre_sigma',
        'motion.adaptation_time': 'motion.angular_acc_tau',
        'motion.point_sigma': 'motion.information_scale',
        'verification.min_overlap': '',
        'verification.max_shift': '',
        'pose_graph.min_overlap': '',
        'odometry.max_keyframe_missing': 'odometry.max_keyframe_missing_reference',
        'odometry.max_found_missing': '',
        'verification.max_free_space': '',
        'verification.max_outside': '',
        'verification.max_rms': '',
        'verification.max_conflict_ratio': '',
        'verification.max_silhouette_violation': '',
        'verdict.min_observability': 'verdict.min_turning_loss',
        'verdict.min_rotation_cost_ratio': 'verdict.min_turning_loss',
        'odometry.min_overlap': '',
        'odometry.max_rms': '',
        'odometry.max_conflict_ratio': '',
        'odometry.max_silhouette_violation': '',
        'odometry.max_relocalized_missing_reference': '',
        'verdict.max_rms': '',
        'verdict.max_conflict_ratio': '',
        'verdict.min_visible_inlier_ratio': '',
        'verdict.max_model_conflict_ratio': '',
        'verdict.max_model_free_space_violation': '',
        'verdict.max_pose_correction_deg': '',
        'verdict.max_pose_correction': '',
        'verdict.max_outlier_deg': '',
        'verdict.min_cost_ratio': '',
        'verdict.max_model_silhouette_violation': '',
        'verdict.max_rejected_closures': '',
        'verdict.min_turn_cost': 'verdict.min_turning_loss',
        'verdict.max_free_space': '',
        'verdict.min_explained': '',
        'verdict.max_model_free_space': '',
        'verdict.max_model_contradicted': '',
        'verdict.max_settling_deg': '',
        'verdict.max_settling': '',
        'verdict.telling_cost': '',
        'verdict.max_model_outside': '',
        'verdict.max_bent': '',
    }

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

    def updated(self, values: dict[str, Any]) -> 'Settings':
        """A copy with other values: ``Settings().updated({'isolation.box_max': (2.0, 2.0, 3.0)})``.

        Raises:
            ParameterError: an unknown name, a value of another type, or one out of range; a ValueError.
        """
        return updated(self, values)

    @staticmethod
    def load(path: Path | str) -> 'Settings':
        """From a parameter file, as ``params/default.yaml``; what it does not name has its default.

        Raises:
            ParameterError: the file is missing or malformed, or as :meth:`updated`.
        """
        return load(Settings(), Path(path))


# What limits memory and time. A larger value decides nothing else: it costs more.
BUDGETS = frozenset(
    (
        'odometry.max_keyframes', 'odometry.recent_keyframes', 'odometry.tracked_keyframes',
        'closure_search.neighbours', 'closure.verified', 'pose_graph.pairs', 'pose_graph.iterations',
        'fusion.max_voxels', 'fusion.max_frames', 'builder.kept_frames', 'builder.growth',
    )
)  # fmt: skip
# What a user says of the scene, the thesis's variants of the descriptor, and the model's resolution.
OPTIONS = frozenset(
    (
        'isolation.box_min', 'isolation.box_max', 'motion.mean_motion',
        'descriptor.binning', 'descriptor.size_component', 'descriptor.normalise_distance',
        'fusion.voxel', 'fusion.min_weight', 'fusion.inside', 'fusion.smoothing',
    )
)  # fmt: skip


def tunables() -> list[str]:
    """The numbers that decide, from depth to verdict: all parameters but budgets and options."""
    return [name for name in flatten(Settings()) if name not in BUDGETS | OPTIONS]


HEADER = """\
# All parameters of the scanner with their defaults: one preset for every target. Generated by
#   python -m debris_scanner.settings > params/default.yaml
# A copy may keep only the keys that it changes; an unknown key or a value out of range is refused.
"""


def render(settings: Any) -> str:
    """ROS 2 parameter file of nested settings, with a comment above each key."""
    lines = ['/**:', '  ros__parameters:']
    for group in dataclasses.fields(settings):
        value = getattr(settings, group.name)
        lines += [f'    # {_first_line(value)}', f'    {group.name}:']
        for f in dataclasses.fields(value):
            lines += [f'      # {_comment(f)}', f'      {f.name}: {_yaml(getattr(value, f.name))}']
    return HEADER + '\n'.join(lines) + '\n'


def _first_line(settings: Any) -> str:
    return (type(settings).__doc__ or '').strip().splitlines()[0]


def _comment(f: 'dataclasses.Field[Any]') -> str:
    """Description, unit and range of a parameter."""
    parts = [f.metadata['doc'] + (f' [{f.metadata["unit"]}]' if f.metadata['unit'] else '')]
    low, high = f.metadata['low'], f.metadata['high']
    if math.isfinite(low) and math.isfinite(high):
        parts.append(f'{low:g} to {high:g}')
    elif math.isfinite(low):
        parts.append(f'at least {low:g}')
    elif math.isfinite(high):
        parts.append(f'at most {high:g}')
    return ', '.join(parts)


def _yaml(value: Any) -> str:
    """A value as both YAML 1.1 and ROS read it: a double has a decimal point and no exponent."""
    if isinstance(value, tuple):
        return f'[{", ".join(_yaml(v) for v in value)}]'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        digits = format(Decimal(repr(value)), 'f')
        return digits if '.' in digits else f'{digits}.0'
    return str(value)


if __name__ == '__main__':
    sys.stdout.write(render(Settings()))
