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

"""Parameters: declared once, read from ROS parameter files, every value checked."""

from dataclasses import dataclass, field

import pytest

from debris_scanner.core.parameters import ParameterError, field_of, flatten, load, parameter, updated


@dataclass(frozen=True)
class Inner:
    """A group."""

    gain: float = parameter(0.5, 'how much', 'm', 0.0, 1.0)
    count: int = parameter(3, 'how many', '', 1, 10)
    box: tuple[float, float] = parameter((-0.4, 0.4), 'limits', 'm', -5.0, 5.0)


@dataclass(frozen=True)
class Outer:
    """The tree."""

    name: str = parameter('a', 'what it is called')
    fast: bool = parameter(True, 'whether it hurries')
    inner: Inner = field(default_factory=Inner)


def write(tmp_path, text):
    path = tmp_path / 'params.yaml'
    path.write_text(text)
    return path


def test_flatten_names_parameters_as_ros_does():
    assert flatten(Outer()) == {
        'name': 'a',
        'fast': True,
        'inner.gain': 0.5,
        'inner.count': 3,
        'inner.box': [-0.4, 0.4],
    }


def test_updated_changes_the_copy_and_not_the_original():
    before = Outer()
    after = updated(before, {'inner.gain': 0.25, 'name': 'b', 'inner.box': [-1.0, 1]})
    assert (after.inner.gain, after.name, after.inner.box) == (0.25, 'b', (-1.0, 1.0))
    assert before == Outer()


def test_flattened_values_update_to_the_same_settings():
    settings = updated(Outer(), {'inner.count': 7, 'fast': False})
    assert updated(Outer(), flatten(settings)) == settings


def test_whole_number_serves_as_a_float():
    value = updated(Outer(), {'inner.gain': 1}).inner.gain
    assert value == 1.0
    assert type(value) is float


@pytest.mark.parametrize('name', ['speed', 'inner.speed', 'inner', 'outer.gain', 'inner.gain.low', ''])
def test_unknown_names_are_refused(name):
    with pytest.raises(ParameterError, match=f"unknown parameter '{name}'"):
        updated(Outer(), {name: 1.0})


def test_a_slip_of_the_pen_is_recognised():
    with pytest.raises(ParameterError, match=r"'inner.gian'; did you mean 'inner.gain'\?"):
        updated(Outer(), {'inner.gian': 1.0})


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('inner.gain', '0.5'),
        ('inner.gain', True),
        ('inner.gain', None),
        ('inner.count', 3.0),
        ('inner.count', True),
        ('fast', 1),
        ('name', 5),
        ('inner.box', [0.0]),
        ('inner.box', [0.0, 1.0, 2.0]),
        ('inner.box', 0.4),
        ('inner.box', '01'),
        ('inner.box', ['a', 'b']),
    ],
)
def test_other_types_are_refused(name, value):
    with pytest.raises(ParameterError, match=name):
        updated(Outer(), {name: value})


@pytest.mark.parametrize(('name', 'low', 'high'), [('inner.gain', 0.0, 1.0), ('inner.count', 1, 10)])
def test_ranges_include_their_ends(name, low, high):
    for value in (low, high):
        assert flatten(updated(Outer(), {name: value}))[name] == value


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('inner.gain', -0.001),
        ('inner.gain', 1.001),
        ('inner.gain', float('inf')),
        ('inner.count', 0),
        ('inner.count', 11),
        ('inner.box', [-6.0, 1.0]),
    ],
)
def test_values_out_of_range_are_refused(name, value):
    with pytest.raises(ParameterError, match=f'{name} = .* is outside'):
        updated(Outer(), {name: value})


def test_field_carries_description_unit_and_range():
    meta = field_of(Outer(), 'inner.gain').metadata
    assert (meta['doc'], meta['unit'], meta['low'], meta['high']) == ('how much', 'm', 0.0, 1.0)


def test_file_in_the_form_ros_reads(tmp_path):
    text = '/**:\n  ros__parameters:\n    name: b\n    inner:\n      gain: 0.75\n      box: [-1.0, 1.0]\n'
    settings = load(Outer(), write(tmp_path, text))
    assert settings == Outer('b', True, Inner(0.75, 3, (-1.0, 1.0)))


def test_dotted_names_in_a_file(tmp_path):
    assert load(Outer(), write(tmp_path, '/**:\n  ros__parameters:\n    inner.count: 9\n')).inner.count == 9


def test_what_is_no_number_is_called_that():
    with pytest.raises(ParameterError, match=r'inner\.gain is no number'):
        updated(Outer(), {'inner.gain': float('nan')})


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('', 'no ROS 2 parameter file'),
        ('[1, 2]', 'no ROS 2 parameter file'),
        ('name: b', 'no ROS 2 parameter file'),
        ('/**:\n  name: b', 'no ROS 2 parameter file'),
        ('/**:\n  ros__parameters: 5', 'no ROS 2 parameter file'),
        ('/a:\n  ros__parameters: {}\n/b:\n  ros__parameters: {}', 'no ROS 2 parameter file'),
        ('/**: [', 'cannot read parameters'),
        ('/**:\n  ros__parameters:\n    nmae: b', "unknown parameter 'nmae'"),
        ('/**:\n  ros__parameters:\n    inner:\n      gain: 7.0', 'inner.gain = 7.0 is outside'),
        ('/**:\n  ros__parameters:\n    inner: 7.0', "unknown parameter 'inner'"),
    ],
)
def test_unusable_file_is_refused_by_name(tmp_path, text, complaint):
    path = write(tmp_path, text)
    with pytest.raises(ParameterError, match=r'params\.yaml') as refused:
        load(Outer(), path)
    assert complaint in str(refused.value)


def test_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(ParameterError, match=r'none\.yaml'):
        load(Outer(), tmp_path / 'none.yaml')
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe\x00\x81')
    with pytest.raises(ParameterError, match=r'binary\.yaml'):
        load(Outer(), tmp_path / 'binary.yaml')
