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

"""What the verb batch has done with each recording is what the verb scan does."""

import json

import pytest

from debris_scanner.batch.recording import BadRecording
from debris_scanner.cli.batch import scan_quietly
from debris_scanner.cli.main import main


@pytest.fixture(scope='module')
def short(tmp_path_factory):
    """Ten frames of a target: soon scanned, to no model."""
    bag = tmp_path_factory.mktemp('short') / 'bag'
    assert main(['simulate', 'cubesat', '--seconds', '1', '--out', str(bag)]) == 0
    return bag


def test_a_recording_is_scanned_with_its_parameters(short, tmp_path):
    params = tmp_path / 'params.yaml'
    params.write_text('/**:\n  ros__parameters:\n    verdict:\n      max_gain: 0.1\n')
    for given, name in ((None, 'default'), (params, 'given')):
        scan_quietly(short, tmp_path / name, given)
    default, given = (json.loads((tmp_path / n / 'summary.json').read_bytes()) for n in ('default', 'given'))
    assert default['frames'] == given['frames'] == {'read': 10, 'used': 10, 'rejected': {}}
    assert default['result'] == 'no_model'
    assert main(['scan', str(short), '--out', str(tmp_path / 'plain'), '--params', str(params)]) == 3
    plain = json.loads((tmp_path / 'plain' / 'summary.json').read_bytes())
    assert plain['reason'] == given['reason']


def test_no_recording_is_one_reason_without_the_path(tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(BadRecording) as found:
        scan_quietly(tmp_path / 'bag', tmp_path / 'out', None)
    assert str(tmp_path) not in str(found.value)
