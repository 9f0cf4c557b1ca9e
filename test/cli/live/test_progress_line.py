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

"""The line of progress on a terminal: one line at any width, and colour only where it belongs."""

import fcntl
import os
import pty
import struct
import termios

import pytest

from debris_scanner.cli.live.progress_line import ProgressLine, clipped, has_colour, in_colour


@pytest.fixture
def terminal(monkeypatch):
    """A real terminal of 40 columns, and what it was sent."""
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.delenv('NO_COLOR', raising=False)
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 40, 0, 0))
    with os.fdopen(slave, 'w') as stream:
        yield stream, lambda: sent_to(stream, master)
    os.close(master)


def sent_to(stream, master):
    """All that was written so far; the end is marked, for a terminal hands on in pieces, later."""
    stream.write('\0')
    stream.flush()
    text = ''
    while not text.endswith('\0'):
        text += os.read(master, 65536).decode(errors='replace')
    return text[:-1]


def test_a_long_text_stays_on_its_line(terminal):
    stream, sent = terminal
    line = ProgressLine(stream)
    for k in range(20):
        line.show(f'/points has {k} publishers, and the text goes on for more than\nforty columns')
    text = sent()
    assert '\n' not in text
    assert all(len(shown) <= 39 for shown in text.split('\r'))
    assert text.endswith('…')


def test_what_was_longer_is_wiped(terminal):
    stream, sent = terminal
    line = ProgressLine(stream)
    line.show('a' * 100)
    line.show('short')
    assert sent().split('\r')[-1] == 'short' + ' ' * 34


def test_a_known_state_is_coloured_unless_the_user_says_no(terminal, monkeypatch):
    stream, sent = terminal
    ProgressLine(stream).show('tracking 10 frames')
    assert sent() == '\r\x1b[32mtracking\x1b[0m 10 frames'
    monkeypatch.setenv('NO_COLOR', '1')
    assert not has_colour(stream)
    ProgressLine(stream).show('tracking 10 frames')
    assert sent() == '\rtracking 10 frames'


def test_no_colour_in_files_and_on_plain_terminals(terminal, monkeypatch, tmp_path):
    stream, _ = terminal
    monkeypatch.setenv('TERM', 'dumb')
    assert not has_colour(stream)
    with (tmp_path / 'log').open('w') as file:
        assert in_colour('FAIL  thing', file) == 'FAIL  thing'


def test_clipped():
    assert clipped('abc', 3) == 'abc'
    assert clipped('abcd', 3) == 'ab…'
    assert clipped('a\nb', 9) == 'a b'
