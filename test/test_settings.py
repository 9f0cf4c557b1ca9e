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

"""The parameter file that users copy: it holds the declared defaults, all of them, and ROS can read it."""

import dataclasses
from pathlib import Path

import pytest
import yaml

from debris_scanner.core.parameters import ParameterError, field_of, flatten, load, updated
from debris_scanner.settings import BUDGETS, OPTIONS, Settings, render, tunables

DEFAULTS = Path(__file__).parents[1] / 'params' / 'default.yaml'
NAMES = sorted(flatten(Settings()))


def test_default_file_is_the_declared_defaults_with_every_key():
    (node,) = yaml.safe_load(DEFAULTS.read_text()).values()
    tree = node['ros__parameters']
    in_file = {f'{group}.{key}': value for group, keys in tree.items() for key, value in keys.items()}
    assert in_file == flatten(Settings())
    assert load(Settings(), DEFAULTS) == Settings()


def test_default_file_is_the_generated_one():
    assert DEFAULTS.read_text() == render(Settings()), (
        'a declared parameter changed: python -m debris_scanner.settings > params/default.yaml'
    )


@pytest.mark.parametrize('name', NAMES)
def test_every_key_is_explained(name):
    f = field_of(Settings(), name)
    lines = DEFAULTS.read_text().splitlines()
    group, key = name.split('.')
    start = lines.index(f'    {group}:')
    row = next(k for k in range(start, len(lines)) if lines[k].startswith(f'      {key}: '))
    assert lines[row - 1].startswith(f'      # {f.metadata["doc"]}')
    assert not f.metadata['unit'] or f'[{f.metadata["unit"]}]' in lines[row - 1]


@pytest.mark.parametrize('value', [1e-5, 2e-4, 1.0, 123456789.5, 1e16, -0.4])
def test_floats_keep_value_and_type(tmp_path, value):
    settings = Settings()
    motion = dataclasses.replace(settings.motion, rate_sigma=value)
    text = render(dataclasses.replace(settings, motion=motion))
    read = yaml.safe_load(text)['/**']['ros__parameters']['motion']['rate_sigma']
    assert type(read) is float  # ROS would refuse an integer for a double
    assert read == value


def test_changed_settings_come_back_from_their_file(tmp_path):
    settings = updated(Settings(), {'isolation.box_max': [0.5, 0.5, 2.0], 'closure.verified': 7})
    path = tmp_path / 'params.yaml'
    path.write_text(render(settings))
    assert load(Settings(), path) == settings != Settings()


def test_misspelt_key_is_named(tmp_path):
    path = tmp_path / 'params.yaml'
    path.write_text(render(Settings()).replace('cluster_gap:', 'cluster_gaps:'))
    with pytest.raises(ParameterError, match=r'isolation\.cluster_gaps'):
        load(Settings(), path)


def test_a_parameter_that_is_none_is_one_clear_line(tmp_path):
    path = tmp_path / 'params.yaml'
    for name in ('odometry.max_gap', 'verdicts.max_gain', 'isolation'):
        group, _, leaf = name.partition('.')
        path.write_text(f'/**:\n  ros__parameters:\n    {group}: {{{leaf}: 0.5}}\n' if leaf
                        else f'/**:\n  ros__parameters:\n    {group}: 0.5\n')  # fmt: skip
        with pytest.raises(ParameterError, match='unknown parameter') as caught:
            load(Settings(), path)
        assert repr(name) in str(caught.value) and str(path) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


def test_few_numbers_decide():
    known = flatten(Settings())
    assert not (BUDGETS | OPTIONS) - known.keys()
    assert not BUDGETS & OPTIONS
    assert len(tunables()) <= 30
