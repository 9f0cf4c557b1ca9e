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

"""ROS parameters with descriptors and validation: the scanner's settings, and those of single nodes.

:func:`declare` and :func:`declare_live` declare a parameter of one node, :class:`SettingsParameters` groups
of the scanner's settings. One file may hold the parameters of all nodes: :data:`NODES` names those that are
no settings, so that :func:`refuse_unknown` refuses only keys that no node has. A test compares NODES with the
declarations.
"""

import math
import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from debris_scanner.core.parameters import ParameterError, did_you_mean, field_of, flatten, updated
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.settings import Settings

_CAMERA = (
    'colour',
    'cx',
    'cy',
    'device',
    'frame_id',
    'fx',
    'fy',
    'library',
    'max_rate_hz',
    'registered',
    'rgb_frame_id',
    'wait_for_stages',
    'wait_for_subscribers',
)

NODES: dict[str, tuple[str, ...]] = {
    'preprocess': (
        'autostart',
        'axes',
        'depth_scale',
        'input',
        'input_depth',
        'input_reliability',
        'journal_dir',
    ),
    'odometry': (
        'autostart',
        'frame_prefix',
        'journal_dir',
        'publish_tf',
    ),
    'closure': (
        'autostart',
        'journal_dir',
    ),
    'graph': (
        'autostart',
        'exit_after_idle',
        'extend',
        'finish_after_idle',
        'frame_prefix',
        'journal_dir',
        'max_mesh_triangles',
        'model',
        'output_dir',
        'save_as',
    ),
    'scanner': (
        'autostart',
        'axes',
        'depth_scale',
        'exit_after_idle',
        'extend',
        'finish_after_idle',
        'frame_prefix',
        'input',
        'input_depth',
        'input_reliability',
        'journal_dir',
        'max_mesh_triangles',
        'model',
        'output_dir',
        'publish_tf',
        'save_as',
    ),
    'sim_kinect': (
        'axis_sensor',
        'bump_px',
        'centre_of_mass',
        'clutter',
        'colour',
        'correlated',
        'damping_s',
        'doubled',
        'focal_error',
        'frame_id',
        'gaps',
        'gaps_from_s',
        'hand',
        'inertia',
        'infrared',
        'junk_share',
        'leaves_s',
        'light',
        'mli',
        'mli_share',
        'motion',
        'noise',
        'paint',
        'patchy',
        'range_m',
        'rate_hz',
        'seconds',
        'seed',
        'sensor',
        'size',
        'spatial_filter',
        'spin_about',
        'spin_rad_s',
        'stay',
        'target',
        'temporal_filter',
        'truth_dir',
        'wait_for_stages',
        'wait_for_subscribers',
    ),
    'play_bag': ('bag', 'clock', 'loops', 'rate', 'stay', 'topic', 'wait_for_stages', 'wait_for_subscribers'),
    'record_scan': ('bag',),
    'openni2_camera': tuple(sorted((*_CAMERA, 'height', 'repeat', 'width'))),
    'freenect_camera': _CAMERA,
    'viewer': ('host', 'max_points', 'max_rate_hz', 'owner', 'port', 'result_dir'),
}

_INT_LIMIT = 2**63 - 1
# share of letters that match: two swapped among ten are a slip, publish_rate is no publish_tf
MISSPELT = 0.85
_OF_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


def declare(
    node: Node,
    name: str,
    default: Any,
    doc: str,
    low: float = -math.inf,
    high: float = math.inf,
    choices: Sequence[str] = (),
) -> Any:
    """Declare a read-only parameter of a node and return its value.

    Where a lifecycle manager configures the node, it may be set until then: see :mod:`.managed`.

    Raises:
        ParameterError: the value given at the start is of another type, out of range or no choice.
    """
    if choices:
        doc = f'{doc}: {" or ".join(choices)}'
    value = _declared(node, name, default, _descriptor(doc, default, low, high, read_only=True))
    if choices and value not in choices:
        raise ParameterError(f'{name} must be one of {", ".join(choices)}, got {value!r}')
    return value


def declare_path(node: Node, name: str, doc: str) -> Path | None:
    """Declare a read-only file or folder; None where it is empty. A leading tilde is the home folder."""
    value = declare(node, name, '', doc)
    return Path(value).expanduser() if value else None


def declare_live(
    node: Node,
    name: str,
    default: Any,
    doc: str,
    low: float = -math.inf,
    high: float = math.inf,
    check: Callable[[Any], None] = lambda _: None,
) -> Callable[[], Any]:
    """Declare a parameter that may change while the node runs; returns a function that reads its value.

    Args:
        node: that has it.
        name: of the parameter.
        default: value.
        doc: description.
        low: least value.
        high: largest value.
        check: raises a ParameterError for a value that cannot be used, now or when it is set.

    Raises:
        ParameterError: the value given at the start is of another type, out of range or refused by ``check``.
    """

    def refuse(parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == name:
                    check(parameter.value)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    again = node.has_parameter(name)
    check(_declared(node, name, default, _descriptor(doc, default, low, high, read_only=False)))
    if not again:
        node.add_on_set_parameters_callback(refuse)
    return lambda: node.get_parameter(name).value


def refuse_unknown(node: Any) -> None:
    """Check the parameters given at the start that are not of this node.

    A file may hold those of other nodes, also of other packages, under ``/**``: they are warned of. One that
    resembles a parameter of this package, or belongs to a group of its settings, is a mistake.

    Raises:
        ParameterError: names the mistaken ones.
    """
    known = set(flatten(Settings())).union(*NODES.values())
    given = [name for name in node._parameter_overrides if not name.startswith(_OF_ROS)]
    unknown = sorted(name for name in given if not node.has_parameter(name) and name not in known)
    groups = {name.split('.')[0] for name in flatten(Settings())}
    mistaken = [n for n in unknown if n.split('.')[0] in groups or did_you_mean(n, known, MISSPELT)]
    if mistaken:
        raise ParameterError(f'unknown parameter {", ".join(mistaken)}{did_you_mean(mistaken[0], known)}')
    if unknown:
        names = f'{", ".join(unknown)} {"is" if len(unknown) == 1 else "are"}'
        node.get_logger().warning(f'{names} no parameter of this package, and ignored')
    # settings of other stages stand in every parameter file
    for name in sorted({n for n in given if not node.has_parameter(n)} & known - set(flatten(Settings()))):
        owners = ', '.join(stage for stage, names in NODES.items() if name in names)
        node.get_logger().warning(f'parameter {name} is ignored here: it is one of {owners}')


def declare_settings(node: Node, groups: Collection[str], live: Collection[str] = ()) -> dict[str, Any]:
    """Declare groups of :class:`Settings` on a node, and return their values by name.

    Args:
        node: that declares them.
        groups: fields of Settings.
        live: groups that may change while the node runs; the others are read-only.

    Raises:
        ParameterError: a value given at the start is of another type or out of range.
    """
    defaults = Settings()
    given = {}
    for name, value in flatten(defaults).items():
        group = name.split('.')[0]
        if group not in groups:
            continue
        f = field_of(defaults, name)
        doc = f'{f.metadata["doc"]} [{f.metadata["unit"]}]' if f.metadata['unit'] else f.metadata['doc']
        low, high = f.metadata['low'], f.metadata['high']
        given[name] = _declared(node, name, value, _descriptor(doc, value, low, high, group not in live))
    return given


class SettingsParameters:
    """Groups of :class:`Settings` declared on a node; ``value`` follows changes by the user.

    Validation has no side effects: a change takes effect once the whole request has been accepted.

    Args:
        node: that declares them.
        groups: fields of Settings.
        live: groups that may change while the node runs; the others are read-only.
        apply: called with the new settings after a change.

    Raises:
        ParameterError: a value given at the start cannot be used.
    """

    def __init__(
        self,
        node: Node,
        groups: Collection[str],
        live: Collection[str] = (),
        apply: Callable[[Settings], None] | None = None,
    ) -> None:
        self._apply = apply
        given = declare_settings(node, groups, live)
        self._names = list(given)
        self.value = updated(Settings(), given)
        self._node = node
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._update)

    def detach(self) -> None:
        """Stop following the node's parameters."""
        self._node.remove_on_set_parameters_callback(self._check)
        self._node.remove_post_set_parameters_callback(self._update)

    def _ours(self, parameters: Sequence[Parameter]) -> dict[str, Any]:
        return {p.name: _plain(p.value) for p in parameters if p.name in self._names}

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            updated(self.value, self._ours(parameters))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _update(self, parameters: Sequence[Parameter]) -> None:
        if ours := self._ours(parameters):
            self.value = updated(self.value, ours)
            if self._apply is not None:
                self._apply(self.value)


def _declared(node: Node, name: str, default: Any, descriptor: ParameterDescriptor) -> Any:
    if node.has_parameter(name):  # the node is configured, or configured again
        return _plain(node.get_parameter(name).value)
    if isinstance(node, StageNode) and descriptor.read_only and not node.autostart:
        descriptor.read_only = False
        node.fixed_once_configured.add(name)
    try:
        return _plain(node.declare_parameter(name, default, descriptor).value)
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise ParameterError(f'parameter {name}: {error}') from None


def _descriptor(doc: str, default: Any, low: float, high: float, read_only: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=doc, read_only=read_only)
    if math.isinf(low) and math.isinf(high):
        return descriptor
    if type(default) is float:
        limit = sys.float_info.max
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(max(low, -limit)), to_value=float(min(high, limit)))
        ]
    elif type(default) is int:
        lowest = -_INT_LIMIT if math.isinf(low) else int(low)
        highest = _INT_LIMIT if math.isinf(high) else int(high)
        descriptor.integer_range = [IntegerRange(from_value=lowest, to_value=highest)]
    return descriptor


def _plain(value: Any) -> Any:
    """Lists for the arrays that rclpy returns."""
    return value if isinstance(value, str | bytes) or not hasattr(value, '__len__') else list(value)
