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

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from debris_scanner.core.geometry import exp_se3
from debris_scanner.core.results import Check, at_least, at_most
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.publishing.closure_publisher import (
    ClosurePublisher,
    candidates_message,
    read_candidates,
)
from msg_adapters.errors import MalformedMessage

STAMP = 1_795_264_289_657_995_302
T_FROM_TO = exp_se3(np.array([0.3, -0.2, 0.1, 1 / 3, 0.5, 0.6]))


CHECKS = (
    at_least('overlap', 2 / 3, 0.4),
    at_most('asked_of_a_step', 0.1, np.inf),
    Check('correction_deg', np.float64(8.1)),
)


def test_closure_hypotheses_come_back_with_every_digit():
    closures = [
        Closure(STAMP, STAMP + 7, 0.1 + 0.2, True, 'overlap 0.9', T_FROM_TO, CHECKS),
        Closure(STAMP + 1, STAMP + 7, 1 / 3, False, 'the views do not overlap', None),
    ]
    records = read_candidates(candidates_message(closures))
    assert records == [c.record for c in closures]
    np.testing.assert_allclose(records[0].T_from_to, T_FROM_TO, atol=1e-15)
    assert records[1].T_from_to is None
    assert (records[0].checks, records[1].checks) == (CHECKS, ())
    with pytest.raises(MalformedMessage):
        read_candidates(DiagnosticArray(status=[DiagnosticStatus()]))


@pytest.mark.parametrize('text', ['1 2 3', '0 0 0 0 0 0 0', '0 0 0 0 0 0 nan', 'a b c d e f g'])
def test_a_pose_that_is_none_is_refused_by_name(text):
    message = candidates_message([Closure(STAMP, STAMP + 7, 0.5, False, 'no', T_FROM_TO)])
    (pose,) = (v for v in message.status[0].values if v.key == 'T_from_to')
    pose.value = text
    with pytest.raises(MalformedMessage, match='T_from_to'):
        read_candidates(message)


@pytest.mark.parametrize('text', ['1 2', '1 2 3', 'a 2 1', ''])
def test_a_check_that_is_none_is_refused_by_name(text):
    message = candidates_message([Closure(STAMP, STAMP + 7, 0.5, True, '', T_FROM_TO, CHECKS)])
    next(v for v in message.status[0].values if v.key == 'check.overlap').value = text
    with pytest.raises(MalformedMessage, match=r'check\.overlap'):
        read_candidates(message)


def test_only_accepted_hypotheses_are_told_in_the_log_and_all_are_published():
    said, sent = {'info': [], 'debug': []}, []
    logger = SimpleNamespace(info=said['info'].append, debug=said['debug'].append)
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=sent.append),
        get_logger=lambda: logger,
        diagnostics=SimpleNamespace(counts=Counter()),
    )
    hypotheses = [
        Closure(STAMP, STAMP + 7, 0.9, True, 'overlap 0.9', T_FROM_TO),
        Closure(STAMP + 1, STAMP + 7, 0.2, False, 'free_space', None),
    ]
    ClosurePublisher(node).publish(hypotheses)
    assert ['accepted' in text for text in said['info']] == [True]
    assert ['refused' in text for text in said['debug']] == [True]
    assert len(sent) == 2 and len(sent[0].status) == 2
    assert node.diagnostics.counts == {'accepted': 1, 'refused': 1}
