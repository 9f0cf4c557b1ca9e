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

"""What the page tells whoever turns the target."""

import numpy as np
import pytest

from debris_scanner.viewer.guidance import STEPS, Guide, Situation, guide


@pytest.mark.parametrize(
    ('now', 'state', 'step'),
    [
        (Situation(), 'waiting', 'put the target'),
        (Situation('waiting'), 'waiting', 'put the target'),
        (Situation('scanning', np.radians(220)), 'scanning', 'turn on: 220° of 360° seen'),
        (Situation('scanning', 7.0), 'scanning', 'a whole turn seen: turn on'),
        (Situation('generating'), 'generating', 'turn on'),
        (Situation('tracking'), 'tracking', 'the target is tracked'),
        (Situation('lost'), 'lost', 'lost: hold it where it was'),
        (Situation('lost', rejected={'no_target': 10}, received=10), 'lost', 'lost: hold it where it was'),
        (Situation('finished'), 'finished', 'the scan has ended'),
        (Situation('scanning', paused=True), 'paused', 'frames are dropped'),
        (Situation('scanning', cut=frozenset({'left', 'right'})), 'scanning', 'too near'),
        (Situation('scanning', cut=frozenset({'top'})), 'scanning', 'cut off at the top of the image'),
        (Situation('scanning', rejected={'no_target': 6}, received=10), 'scanning', 'no target in sight'),
        (Situation('scanning', rejected={'touched': 9}, received=10), 'scanning', 'take the hand away'),
        (Situation('scanning', 1.0, rejected={'touched': 2}, received=10), 'scanning', 'turn on: 57°'),
        (Situation('scanning', source_ended=True), 'scanning', 'the recording has ended'),
        (
            Situation('tracking', phase='refine 3 of 9'),
            'generating',
            'the last model is being made: refine 3',
        ),
        (Situation('tracking', result={'result': 'model'}), 'finished', 'the model is done'),
        (Situation('lost', result={'result': 'tracked'}), 'finished', 'the known model was tracked'),
        (
            Situation('scanning', result={'result': 'no_model', 'reason': 'no_closure'}),
            'no model',
            'no_closure',
        ),
        (Situation('an unknown one'), 'an unknown one', ''),
    ],
)
def test_state_and_next_step(now, state, step):
    told = guide(now)
    assert told.state == state
    assert told.step.startswith(step)


def test_every_state_has_a_step():
    assert all(STEPS.values())
    assert guide(Situation('scanning')) == Guide('scanning', 'turn on: 0° of 360° seen')
