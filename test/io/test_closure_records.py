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

"""Closure hypotheses survive JSON, with their registered pose."""

import json

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_se3
from debris_scanner.core.results import Check, ClosureRecord, at_least
from debris_scanner.io.closure_records import closure_values, read_closure_values

T_FROM_TO = exp_se3(np.array([0.3, -0.2, 0.1, 1 / 3, 0.5, 0.6]))


@pytest.mark.parametrize('T', [None, T_FROM_TO])
def test_there_and_back(T):
    checks = (at_least('overlap', 2 / 3, 0.4), Check('correction_deg', 8.1))
    stamps = 1_795_264_289_657_995_302, 1_795_264_289_657_995_309
    record = ClosureRecord(*stamps, 1 / 3, True, 'good', T, checks)
    back = read_closure_values(json.loads(json.dumps(closure_values(record))))
    assert back == record
    if T is None:
        assert back.T_from_to is None
    else:
        np.testing.assert_allclose(back.T_from_to, T, atol=1e-15)


def test_an_earlier_release_wrote_no_pose_and_null_for_no_number():
    old = {'from_stamp_ns': 1, 'to_stamp_ns': 2, 'probability': None, 'accepted': False, 'why': 'no'}
    back = read_closure_values(old)
    assert back.T_from_to is None and np.isnan(back.probability) and back.checks == ()


@pytest.mark.parametrize('pose', [[1, 2, 3], [0] * 7, 'x', {}, 5, [None] * 7])
def test_a_pose_that_is_none_is_refused(pose):
    with pytest.raises((TypeError, ValueError)):
        read_closure_values(closure_values(ClosureRecord(1, 2, 0.5, True, '')) | {'T_from_to': pose})
