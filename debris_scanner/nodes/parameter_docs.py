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

"""Generates docs/parameters.md from the nodes: ``python -m debris_scanner.nodes.parameter_docs BAG``.

Each node is made once, asked for its parameters and their descriptors, and closed. BAG is any recording: the
player needs one.
"""

import dataclasses
import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor

from debris_scanner.core.parameters import flatten
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import NODES
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.settings import Settings
from debris_scanner.viewer.server import PORT

HEADER = """\
# Parameters

Generated from the declarations: `python -m debris_scanner.nodes.parameter_docs BAG > docs/parameters.md`.

A value out of range, a value of another type, or a misspelt key ends the node at its start with exit code 2
and one line that names it; a key of another package is warned of. `ros2 param set` rejects it with the same
text and changes nothing.
"""
SHARED = """\
## Settings of the scanner

For all nodes in one file, with meaning, unit and range of each: [default.yaml](../params/default.yaml). A px
is [what a pixel covers at the target](sensing.md#lengths): 1.5 mm for a Kinect at 0.8 m. Where no node is
named, a group is fixed at the start of a node, because stored data depends on it.
"""
OWN = """\
## Parameters of the nodes

*Live* ones may change while the node runs.
"""
GROUPS = ('group', 'what it decides', 'may change in a running')
COLUMNS = ('parameter', 'default; range', 'meaning')
_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')

Declared = dict[str, tuple[Any, ParameterDescriptor]]


def declared_by_nodes(bag: str) -> dict[str, Declared]:
    """Value and descriptor of every parameter of every node.

    Args:
        bag: a recording for the player.
    """
    given = {'play_bag:bag': bag, 'viewer:port': 0}
    parameters = [p for name, value in given.items() for p in ('-p', f'{name}:={value}')]
    rclpy.init(args=['--ros-args', *parameters], domain_id=101)
    try:
        declared = {name: _declared(_make(name)) for name in NODES}
        declared['play_bag']['bag'] = '', declared['play_bag']['bag'][1]
        declared['viewer']['port'] = PORT, declared['viewer']['port'][1]
        return declared
    finally:
        rclpy.shutdown()


def own_names(declared: dict[str, Declared]) -> dict[str, tuple[str, ...]]:
    """Parameters of each node that are not settings of the scanner, sorted."""
    shared = flatten(Settings())
    return {node: tuple(sorted(set(names) - set(shared))) for node, names in declared.items()}


def render(declared: dict[str, Declared]) -> str:
    """The document; what several nodes declare alike is there once."""
    parts = [HEADER, SHARED, _table(GROUPS, _groups(declared)), OWN]
    users: dict[tuple[str, ...], list[str]] = {}
    for node, names in own_names(declared).items():
        for name in names:
            row = _row(name, *declared[node][name])
            users.setdefault(row, []).append(node)
    sections: dict[str, list[tuple[str, ...]]] = {}
    for row, nodes in users.items():
        sections.setdefault(', '.join(nodes), []).append(row)
    parts += [f'### {nodes}\n\n{_table(COLUMNS, rows)}' for nodes, rows in sections.items()]
    return '\n'.join(parts)


def _groups(declared: dict[str, Declared]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for group in (field.name for field in dataclasses.fields(Settings)):
        title = (type(getattr(Settings(), group)).__doc__ or '').strip().splitlines()[0]
        live = [
            node
            for node, found in declared.items()
            if any(n.startswith(f'{group}.') and not d.read_only for n, (_, d) in found.items())
        ]
        rows.append((f'`{group}`', title.rstrip('.'), ', '.join(live)))
    return rows


def _row(name: str, value: Any, descriptor: ParameterDescriptor) -> tuple[str, ...]:
    default = '; '.join(filter(None, (f'`{_plain(value)}`', _range(descriptor))))
    return f'`{name}`', default, descriptor.description + ('' if descriptor.read_only else ' (live)')


def _range(descriptor: ParameterDescriptor) -> str:
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        huge = 1e300 if descriptor.floating_point_range else 2**62
        low, high = limits.from_value, limits.to_value
        if high > huge:
            return f'at least {low:g}'
        return f'at most {high:g}' if low < -huge else f'{low:g} to {high:g}'
    return ''


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f'| {" | ".join(columns)} |', '|---' * len(columns) + '|']
    lines += [f'| {" | ".join(cell.replace("|", "/") for cell in row)} |' for row in rows]
    return '\n'.join(lines) + '\n'


def _plain(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return str(list(value) if hasattr(value, '__len__') else value)


def _make(name: str) -> Any:
    """A node of this package."""
    module = importlib.import_module(f'debris_scanner.nodes.{name}')
    kinds = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
    (kind,) = (k for k in kinds if issubclass(k, StageNode))
    make: Callable[[], StageNode] = kind  # the class of an executable takes no arguments
    node = make()
    if isinstance(node, ManagedNode):
        node.start()
    return node


def _declared(node: Any) -> Declared:
    names = sorted(n for n in node._parameters if not n.startswith(_ROS))
    found = {n: (node.get_parameter(n).value, node.describe_parameter(n)) for n in names}
    node.close()
    node.destroy_node()
    return found


if __name__ == '__main__':
    sys.stdout.write(render(declared_by_nodes(sys.argv[1])))
