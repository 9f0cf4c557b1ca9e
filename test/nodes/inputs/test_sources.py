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

from debris_scanner.nodes.inputs.sources import Due, Pacer, wait_for


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
