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

"""Ctrl-C as a request: the first one is noted, and acted on when asked; the second one raises."""

import os
import signal
import threading

import pytest

from debris_scanner.interruption import SIGNALS, Interruption


@pytest.fixture
def stop():
    """A handler that raises, in place for all signals."""

    def stop(*_):
        raise KeyboardInterrupt('stopped')

    before = {n: signal.signal(n, stop) for n in SIGNALS}
    yield stop
    for n, handler in before.items():
        signal.signal(n, handler)


@pytest.mark.parametrize('number', SIGNALS)
def test_first_signal_is_noted_and_the_second_one_raises(number, stop):
    with pytest.raises(KeyboardInterrupt, match='stopped'), Interruption() as interruption:
        assert not interruption.requested
        os.kill(os.getpid(), number)
        assert interruption.requested
        os.kill(os.getpid(), number)
        pytest.fail('the second signal was swallowed')
    assert all(signal.getsignal(n) is stop for n in SIGNALS)


@pytest.mark.usefixtures('stop')
@pytest.mark.parametrize('number', SIGNALS)
def test_what_was_asked_happens_where_it_can(number):
    with Interruption() as interruption:
        interruption.act()
        os.kill(os.getpid(), number)
        with pytest.raises(KeyboardInterrupt, match='stopped'):
            interruption.act()
        interruption.act()  # once


def test_handlers_are_put_back_after_an_error():
    before = [signal.getsignal(n) for n in SIGNALS]
    with pytest.raises(ZeroDivisionError), Interruption():
        assert [signal.getsignal(n) for n in SIGNALS] != before
        1 / 0
    assert [signal.getsignal(n) for n in SIGNALS] == before


def test_other_threads_may_use_it_though_no_signal_reaches_them():
    seen = []

    def work():
        with Interruption() as interruption:
            seen.append(interruption.requested)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]
