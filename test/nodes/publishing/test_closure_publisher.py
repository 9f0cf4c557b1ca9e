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

"""Closure hypotheses survive the round trip through messages."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from debris_scanner.core.geometry import transform
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.publishing.closure_publisher import candidates_message, read_candidates
from msg_adapters.errors import MalformedMessage

STAMP = 1_795_264_289_657_995_302


def test_closure_hypotheses_come_back_with_every_digit():
    closures = [
        Closure(STAMP, STAMP + 7, 0.1 + 0.2, True, 'overlap 0.9', transform(np.eye(3), np.zeros(3))),
        Closure(STAMP + 1, STAMP + 7, 1 / 3, False, 'free_space; outside', np.eye(4)),
    ]
    assert read_candidates(candidates_message(closures)) == [c.record for c in closures]
    with pytest.raises(MalformedMessage):
        read_candidates(DiagnosticArray(status=[DiagnosticStatus()]))
