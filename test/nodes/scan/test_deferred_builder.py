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

"""The builder in a thread of its own: frames go on while a model is made, and nothing gets out of order."""

import threading

import pytest

from debris_scanner.nodes.lifecycle.worker import Worker
from debris_scanner.nodes.scan.deferred_builder import DeferredBuilder


class SlowBuilder:
    """Takes a note of everything; every call waits for a sign."""

    def __init__(self):
        self.go = threading.Event()
        self.calls = []

    def __getattr__(self, name):
        def call(*args):
            self.go.wait(5)
            self.calls.append((name, *args))

        return call


@pytest.fixture
def worker():
    worker = Worker(lambda: None)
    worker.start()
    yield worker
    worker.stop()
    worker.check()


def test_what_is_given_arrives_in_order_and_nobody_waits(worker):
    builder = SlowBuilder()
    deferred = DeferredBuilder(builder, worker)
    deferred.add_keyframe('key frame', False)
    deferred.add_frame('frame', 'pose', False)
    deferred.add_closure('closure')
    deferred.hand_over(lambda: builder.note('taken'))
    deferred.reset()
    deferred.add_frame('next', 'pose', True)
    deferred.hand_over()
    assert builder.calls == []  # the builder is busy, we are here already
    builder.go.set()
    done = threading.Event()
    worker.post(done.set)
    assert done.wait(5)
    assert builder.calls == [
        ('add_keyframe', 'key frame', False),
        ('add_frame', 'frame', 'pose', False),
        ('add_closure', 'closure'),
        ('note', 'taken'),
        ('reset',),
        ('add_frame', 'next', 'pose', True),
    ]


def test_what_one_frame_gives_goes_over_whole():
    worker = Worker(lambda: None)
    deferred = DeferredBuilder(SlowBuilder(), worker)
    deferred.add_keyframe('key frame', False)
    deferred.add_closure('closure')
    assert not worker.backlog
    deferred.hand_over()
    deferred.hand_over()
    assert worker.backlog == 1


def test_it_is_never_due_and_shows_the_rest_of_the_builder(worker):
    class Builder:
        due = True
        keyframes = ('one',)

    deferred = DeferredBuilder(Builder(), worker)
    assert not deferred.should_rebuild
    assert deferred.keyframes == ('one',)
