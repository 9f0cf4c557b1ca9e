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

"""The parameter file as users read it: every parameter with its default, description, unit and range.

``params/default.yaml`` is this module's output and a test keeps it so:
``python -m debris_scanner.parameter_files > params/default.yaml``.
"""

import dataclasses
import math
import sys
from decimal import Decimal
from typing import Any

from debris_scanner.settings import Settings

HEADER = """\
# All parameters of the scanner with their defaults: one preset for every target. Generated, not written:
#   python -m debris_scanner.parameter_files > params/default.yaml
# A copy may keep just the keys that it changes; an unknown key or a value out of range is refused.
"""


def render(settings: Any) -> str:
    """ROS 2 parameter file of nested settings, one commented key a parameter."""
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
    """A value as YAML and ROS both read it: a double needs its point, and YAML 1.1 no exponent without."""
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
