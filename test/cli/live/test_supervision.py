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

"""How a live scan is ended: the owner is asked, and interrupted if it does not hear."""

from types import SimpleNamespace

import pytest

from debris_scanner.cli.errors import CliError
from debris_scanner.cli.live import supervision
from debris_scanner.cli.live.supervision import LiveScan


class Owner:
    """Stands in for graph, its monitor and its process; a tick takes a second."""

    def __init__(self, monkeypatch, heard_after=1, answered_after=3):
        self.now, self.asked, self.interrupted = 0.0, [], []
        self._heard_after, self._answered_after = heard_after, answered_after
        self.exit_code, self.success = 0, True
        monkeypatch.setattr(supervision, 'time', SimpleNamespace(monotonic=lambda: self.now))
        self.scan = object.__new__(LiveScan)
        self.scan._owner = 'graph'
        self.scan._line = SimpleNamespace(show=lambda _: None, end=lambda: None)
        self.scan._interruption = SimpleNamespace(requested=False)
        self.scan._monitor = SimpleNamespace(value=self._value, ask_to_finish=self._ask, state='tracking')
        self.scan._children = SimpleNamespace(
            interrupt=self.interrupted.append,
            wait=lambda *_: True,
            exit_code=lambda _: self.exit_code,
            last_words=lambda _: 'no space',
        )
        self.scan._tick = self._tick

    def _heard(self):
        return len(self.asked) >= self._heard_after

    def _value(self, _node, key):
        return 'making the model' if key == 'phase' and self._heard() else ''

    def _ask(self):
        self.asked.append(self.now)
        done = self._answered_after
        reply = SimpleNamespace(success=self.success, message='not saved')
        return SimpleNamespace(done=lambda: self._heard() and self.now >= done, result=lambda: reply)

    def _tick(self):
        self.now += 1.0
        return []


def test_an_owner_that_answers_is_asked_once(monkeypatch):
    owner = Owner(monkeypatch)
    owner.scan._finish()
    assert owner.asked == [0.0] and owner.interrupted == []


def test_an_owner_that_misses_a_request_is_asked_again(monkeypatch):
    owner = Owner(monkeypatch, heard_after=3, answered_after=20)
    owner.scan._finish()
    assert len(owner.asked) == 3 and owner.interrupted == []


def test_an_owner_that_hears_no_request_is_interrupted_and_saves(monkeypatch, capfd):
    owner = Owner(monkeypatch, heard_after=1000)
    owner.scan._finish()
    assert owner.interrupted == ['graph'] and supervision.UNHEARD_S < owner.now < 2 * supervision.UNHEARD_S
    assert 'graph hears no request' in capfd.readouterr().err
    owner = Owner(monkeypatch, heard_after=1000)
    owner.exit_code = 1
    with pytest.raises(CliError, match='not saved: no space'):
        owner.scan._finish()


def test_a_busy_owner_has_its_time_and_not_more(monkeypatch):
    owner = Owner(monkeypatch, answered_after=500)
    owner.scan._finish()
    assert owner.interrupted == [] and owner.now == 500
    with pytest.raises(CliError, match='did not finish in 600 s'):
        Owner(monkeypatch, answered_after=5000).scan._finish()


def test_what_could_not_be_saved_is_an_error(monkeypatch):
    owner = Owner(monkeypatch)
    owner.success = False
    with pytest.raises(CliError, match='not saved'):
        owner.scan._finish()
