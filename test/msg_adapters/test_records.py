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

"""Records as key-value pairs: the round trip of every field type, and what is malformed."""

from dataclasses import dataclass

import pytest

from msg_adapters.errors import MalformedMessage
from msg_adapters.records import read_record, record_values

STAMP = 1_795_264_289_657_995_302


@dataclass(frozen=True)
class Sample:
    """One field of each type that travels, a stamp, and one field that does not travel."""

    stamp_ns: int
    flag: bool
    count: int
    share: float
    text: str
    parts: tuple[int, ...] = ()


SENT = Sample(STAMP, True, -7, 0.1 + 0.2, 'overlap 0.9, 3 mm', (1, 2))


def as_text(values):
    """Values as a DiagnosticStatus carries them."""
    return {k: repr(v) if isinstance(v, float) else str(v) for k, v in values.items()}


def test_each_type_has_its_form():
    assert record_values(SENT) == {
        'stamp_ns': STAMP,
        'flag': 1,
        'count': -7,
        'share': 0.1 + 0.2,
        'text': 'overlap 0.9, 3 mm',
    }


@pytest.mark.parametrize('flag', [False, True])
@pytest.mark.parametrize('share', [0.0, 1 / 3, -1e-300, 1e300])
@pytest.mark.parametrize('text', ['', 'no model: low overlap', '0'])
def test_a_record_comes_back_with_every_digit(flag, share, text):
    sent = Sample(STAMP, flag, 2**40, share, text)
    assert read_record(Sample, as_text(record_values(sent))) == sent


def test_fields_of_other_types_do_not_travel():
    assert 'parts' not in record_values(SENT)
    assert read_record(Sample, as_text(record_values(SENT))).parts == ()


def test_what_travels_elsewhere_is_given():
    values = as_text(record_values(SENT))
    del values['stamp_ns']
    back = read_record(Sample, values, stamp_ns=5, parts=(1, 2))
    assert (back.stamp_ns, back.parts, back.count) == (5, (1, 2), -7)


def test_a_given_field_replaces_the_pair_even_a_malformed_one():
    values = as_text(record_values(SENT)) | {'count': 'many'}
    assert read_record(Sample, values, count=3).count == 3


def test_further_pairs_are_ignored():
    values = as_text(record_values(SENT)) | {'residual_px': '1.5', 'count2': 'x'}
    assert read_record(Sample, values).count == -7


def test_a_value_that_is_none_does_not_travel():
    assert 'text' not in record_values(Sample(STAMP, True, 1, 0.5, None))


@pytest.mark.parametrize('name', ['stamp_ns', 'flag', 'count', 'share', 'text'])
def test_a_missing_field_is_named(name):
    values = as_text(record_values(SENT))
    del values[name]
    with pytest.raises(MalformedMessage, match=f'Sample without {name}'):
        read_record(Sample, values)


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('flag', ''),
        ('flag', '2'),
        ('flag', 'True'),
        ('count', ''),
        ('count', '1.5'),
        ('count', 'one'),
        ('share', ''),
        ('share', 'nan'),
        ('share', 'inf'),
        ('share', '-inf'),
        ('share', 'half'),
        ('stamp_ns', '-5'),
        ('stamp_ns', '1.5'),
        ('stamp_ns', str(2**70)),
    ],
)
def test_a_bad_value_is_named(name, text):
    values = as_text(record_values(SENT)) | {name: text}
    with pytest.raises(MalformedMessage, match=f'Sample: {name}: '):
        read_record(Sample, values)


def test_a_bad_value_is_cut_in_the_text():
    with pytest.raises(MalformedMessage) as error:
        read_record(Sample, as_text(record_values(SENT)) | {'flag': 'x' * 10_000})
    assert len(str(error.value)) < 200
