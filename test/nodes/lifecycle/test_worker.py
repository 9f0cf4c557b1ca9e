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

"""The worker: order, answers, errors, the end, and its priority."""

import os
import sys
import threading
import time

import pytest

from debris_scanner.nodes.lifecycle.worker import Worker


class TestWorker:
    def test_work_is_done_in_order_and_answers_come_back(self):
        done, between = [], []
        worker = Worker(lambda: between.append(len(done)))
        worker.start()
        for k in range(50):
            worker.post(lambda k=k: done.append(k))
        job = worker.ask(lambda: (True, 'all of it'))
        for _ in job.__await__():
            pass
        assert done == list(range(50))
        assert job.answer == (True, 'all of it')
        worker.stop()
        assert len(between) >= 50
        worker.check()

    def test_what_ends_it_is_raised_and_does_not_leave_a_caller_waiting(self):
        worker = Worker(lambda: None)
        worker.start()

        def fail():
            raise ValueError('broken')

        job = worker.ask(fail)
        for _ in job.__await__():
            pass
        assert job.answer == (False, 'failed: broken')
        worker.stop()
        with pytest.raises(ValueError, match='broken'):
            worker.check()

    def test_a_task_can_let_those_behind_it_go_first(self):
        done = []
        worker = Worker(lambda: None)

        def first():
            worker.work_until(lambda: len(done) == 2, 5.0)
            done.append('first')
            return True, ''

        job = worker.ask(first)
        worker.post(lambda: done.append('second'))
        worker.post(lambda: done.append('third'))
        worker.start()
        for _ in job.__await__():
            pass
        assert done == ['second', 'third', 'first']
        worker.stop()

    def test_caught_up_waits_for_what_was_queued_before(self):
        gate = threading.Event()
        worker = Worker(lambda: None)
        worker.post(lambda: gate.wait(10))
        caught_up = worker.caught_up()
        worker.start()
        worker.post(lambda: None)
        assert not caught_up()
        gate.set()
        deadline = time.monotonic() + 10
        while not caught_up():
            assert time.monotonic() < deadline
            time.sleep(0.005)
        worker.stop()
        assert caught_up()

    def test_caught_up_does_not_wait_for_a_thread_that_has_ended(self):
        worker = Worker(lambda: None)
        worker.start()
        worker.stop()
        assert worker.caught_up()()

    def test_backlog_counts_what_waits(self):
        worker = Worker(lambda: None)
        for _ in range(3):
            worker.post(lambda: None)
        assert worker.backlog == 3
        worker.start()
        worker.stop()
        assert worker.backlog == 0

    @pytest.mark.skipif(
        sys.platform != 'linux', reason='threads of other systems have no niceness of their own'
    )
    def test_only_the_worker_is_nice(self):
        before = os.getpriority(os.PRIO_PROCESS, 0)
        if before > 14:
            pytest.skip('too nice already to become nicer')
        found = []
        worker = Worker(lambda: None, nice=before + 5)
        worker.post(lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
        worker.start()
        worker.stop()
        worker.check()
        assert found == [before + 5]
        assert os.getpriority(os.PRIO_PROCESS, 0) == before
