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

"""Parameters: one dataclass per algorithm, one YAML file for all, the same names in ROS.

A parameter is declared once, as a dataclass field made by :func:`parameter`; its description, unit
and range travel in the field's metadata to the ROS descriptors and the documentation.
"""

import dataclasses
import math
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import yaml

T = TypeVar('T')


class ParameterError(ValueError):
    """A parameter file that cannot be used: unknown key, wrong type, or value out of range."""


@runtime_checkable
class Consistent(Protocol):
    """Settings of which some values exclude others."""

    def check(self) -> None:
        """Check the values together.

        Raises:
            ParameterError: names those that exclude each other.
        """


def parameter(default: Any, doc: str, unit: str = '', low: float = -math.inf, high: float = math.inf) -> Any:
    """Dataclass field of a tunable: default, one-line description, unit, inclusive range."""
    return dataclasses.field(default=default, metadata={'doc': doc, 'unit': unit, 'low': low, 'high': high})


def flatten(settings: Any, prefix: str = '') -> dict[str, Any]:
    """Dotted names and values of nested settings, as ROS 2 names parameters."""
    flat: dict[str, Any] = {}
    for f in dataclasses.fields(settings):
        value = getattr(settings, f.name)
        if dataclasses.is_dataclass(value):
            flat |= flatten(value, f'{prefix}{f.name}.')
        else:
            flat[prefix + f.name] = list(value) if isinstance(value, tuple) else value
    return flat


def field_of(settings: Any, name: str) -> 'dataclasses.Field[Any]':
    """Dataclass field behind a dotted name.

    Raises:
        ParameterError: if there is no such parameter.
    """
    *groups, leaf = name.split('.')
    holder = settings
    for group in groups:
        holder = getattr(holder, group, None)
    fields = {f.name: f for f in dataclasses.fields(holder)} if dataclasses.is_dataclass(holder) else {}
    if leaf not in fields or dataclasses.is_dataclass(getattr(holder, leaf)):
        raise ParameterError(f'unknown parameter {name!r}{did_you_mean(name, flatten(settings))}')
    return fields[leaf]


def did_you_mean(name: str, known: Iterable[str], alike: float = 0.6) -> str:
    """Suffix of an error about an unknown name: the most similar known one, if any.

    Args:
        name: that is unknown.
        known: the others.
        alike: least share of the letters of both that match, in order.
    """
    like = get_close_matches(name, list(known), 1, alike)
    return f'; did you mean {like[0]!r}?' if like else ''


def updated(settings: T, values: dict[str, Any]) -> T:
    """Copy of nested settings with the dotted names in ``values`` replaced, each checked.

    Raises:
        ParameterError: for an unknown name, a value of another type, or one out of range.
    """
    result: Any = settings
    for name, value in values.items():
        checked = _check(name, field_of(settings, name), value)
        result = _replace(result, name.split('.'), checked)
    for f in dataclasses.fields(result):
        group = getattr(result, f.name)
        if isinstance(group, Consistent):
            group.check()
    return result


def load(settings: T, path: Path) -> T:
    """Settings read from a ROS 2 parameter file, ``/**: ros__parameters:`` over nested groups.

    Raises:
        ParameterError: for a file that is missing, unreadable, or names an unknown key.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        reason = getattr(error, 'strerror', None) or error  # without the file's name
        raise ParameterError(f'cannot read parameters {path}: {reason}') from error
    try:
        ((_, node),) = content.items()
        tree = node['ros__parameters']
        names = _leaves(tree)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f'{path} is no ROS 2 parameter file: expected one "/**:" with "ros__parameters:"'
        ) from error
    try:
        return updated(settings, names)
    except ParameterError as error:
        raise ParameterError(f'{path}: {error}') from error


def _leaves(tree: dict[str, Any], prefix: str = '') -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat |= _leaves(value, f'{prefix}{key}.')
        else:
            flat[f'{prefix}{key}'] = value
    return flat


def _replace(settings: Any, path: list[str], value: Any) -> Any:
    if len(path) > 1:
        value = _replace(getattr(settings, path[0]), path[1:], value)
    return dataclasses.replace(settings, **{path[0]: value})


def _check(name: str, f: 'dataclasses.Field[Any]', value: Any) -> Any:
    default, meta = f.default, f.metadata
    if isinstance(default, tuple):
        kind = type(default[0])
        if not isinstance(value, list | tuple) or len(value) != len(default):
            raise ParameterError(f'{name} needs {len(default)} values, got {value!r}')
        return tuple(_scalar(name, kind, v, meta) for v in value)
    return _scalar(name, type(default), value, meta)


def _scalar(name: str, kind: type, value: Any, meta: Any) -> Any:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise ParameterError(f'{name} must be {kind.__name__}, got {value!r}')
    if isinstance(value, float) and math.isnan(value):
        raise ParameterError(f'{name} is no number')
    if kind in (int, float) and not meta.get('low', -math.inf) <= value <= meta.get('high', math.inf):
        raise ParameterError(f'{name} = {value} is outside {meta["low"]} .. {meta["high"]}')
    return value
