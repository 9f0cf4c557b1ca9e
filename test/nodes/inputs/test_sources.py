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

"""The pacer sends a series when its items are due."""

import threading
import time

import numpy as np
import pytest

from debris_scanner.nodes.inputs import sources
from debris_scanner.nodes.inputs.sources import Due, Pacer, WaitingNode, wait_for


class TestPacer:
    def test_sends_when_due_with_the_time_at_which_it_was(self):
        sent = []

        def series():
            for k in range(5):
                yield Due(k * 0.05, lambda due_ns: sent.append((due_ns, time.time_ns())), is_frame=k != 2)

        pacer = Pacer(series(), lambda stop: True)
        pacer.start()
        assert wait_for(lambda: pacer.finished, threading.Event(), 5.0)
        due = np.array([d for d, _ in sent])
        assert list(np.diff(due)) == [50_000_000] * 4
        assert all(at >= d for d, at in sent)
        assert pacer.sent == 4

    def test_stops_at_once_and_passes_errors_on(self):
        pacer = Pacer((Due(k * 60.0, lambda _: None, True) for k in range(9)), lambda stop: True)
        pacer.start()
        wait_for(lambda: pacer.sent == 1, threading.Event(), 5.0)
        pacer.stop()
        assert pacer.finished
        assert pacer.sent == 1

        def broken():
            raise ValueError('no frame')
            yield

        pacer = Pacer(broken(), lambda stop: True)
        pacer.start()
        pacer.stop()
        with pytest.raises(ValueError, match='no frame'):
            pacer.check()


class Waiting(WaitingNode):
    """Waits as a node does, without being one; takes a note of what it says."""

    def __init__(self, stages, wait_s):
        self._waiting_for, self.wait_s, self.awaited, self.said = set(stages), wait_s, (self,), []
        self.subscribers = 0

    def get_subscription_count(self):
        return self.subscribers

    def get_logger(self):
        return self

    info = warning = lambda self, text: self.said.append(text)


class TestWaiting:
    @pytest.fixture(autouse=True)
    def brief(self, monkeypatch):
        monkeypatch.setattr(sources, 'REMIND_S', 0.1)
        monkeypatch.setattr(sources, '_SETTLE_S', 0.0)

    def test_nodes_are_waited_for_however_long_and_it_says_for_which(self):
        node, answers = Waiting({'graph', 'closure'}, wait_s=0.0), []
        thread = threading.Thread(target=lambda: answers.append(node.wait(threading.Event())))
        thread.start()
        wait_for(lambda: len(node.said) >= 3, threading.Event(), 5.0)
        assert set(node.said) == {'waiting for closure graph'}
        assert node.waits and not answers
        node.subscribers = 1
        node._waiting_for.clear()
        thread.join(5.0)
        assert answers == [True]
        assert not node.waits

    def test_for_subscribers_it_waits_so_long_and_no_longer(self):
        node = Waiting((), wait_s=0.2)
        assert node.wait(threading.Event())
        assert node.said == ['no subscriber found in 0 s: playing anyway']

    def test_it_stops_when_told_to(self):
        stop = threading.Event()
        stop.set()
        assert not Waiting({'graph'}, wait_s=60.0).wait(stop)
        assert not Waiting((), wait_s=60.0).wait(stop)
