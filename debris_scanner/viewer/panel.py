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

"""The panel of the page: state and next step, depth, controls, readings, legend, and the end of the scan."""

import html
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.viewer.guidance import Guide

if TYPE_CHECKING:
    import viser

Rgb = tuple[int, int, int]

TITLE = 'debris_scanner'
READINGS = ('Frames', 'Key frames', 'Loop edges', 'Model', 'Turning', 'Turn', 'Distance', 'Remark')
COLOURS: dict[str, Rgb] = {
    'waiting': (150, 150, 160), 'scanning': (80, 160, 255), 'generating': (190, 130, 255),
    'tracking': (70, 200, 110), 'lost': (255, 90, 70), 'paused': (240, 190, 60), 'finished': (70, 200, 110),
    'no model': (255, 90, 70),
}  # fmt: skip
GENERATE, SAVE, FINISH, PAUSE, RESUME, RESET = 'Generate', 'Save', 'Finish', 'Pause', 'Resume', 'Reset'
ACTIONS = (GENERATE, SAVE, FINISH)
CONFIRM_S = 5.0  # within which reset has to be pressed again
_SMALL = 'font-size:0.8em;opacity:0.75'


class Panel:
    """Texts and controls, the same for everyone who opens the page; all texts are shown literally.

    Args:
        server: owner of the panel.
        press: called with the name of an action when its button is pressed; None: there are no buttons.
        legend: colour and meaning of what is drawn.
    """

    def __init__(
        self,
        server: 'viser.ViserServer',
        press: Callable[[str], None] | None,
        legend: Iterable[tuple[Rgb, str]],
    ) -> None:
        gui = server.gui
        self._press = press
        self._armed_s = -CONFIRM_S
        self._lock = threading.Lock()
        self._values = dict.fromkeys(READINGS, '')
        gui.set_panel_label(TITLE)
        self._state = gui.add_html(_state_html(Guide('waiting', '')), order=1.0)
        self._end = gui.add_html('', visible=False, order=2.0)
        self._depth: Any = None
        self._gui = gui
        self._depth_title = gui.add_html('', visible=False, order=3.0)
        self._answer = gui.add_html('', visible=False, order=6.0)
        self._buttons: list[Any] = []
        if press is not None:
            group = gui.add_button_group('Scan', ACTIONS, order=4.0)
            group.on_click(lambda _: press(str(group.value)))
            more = gui.add_button_group('', (PAUSE, RESUME, RESET), order=5.0)
            more.on_click(lambda _: self._reset_twice() if more.value == RESET else press(str(more.value)))
            self._buttons = [group, more]
        self._readings = gui.add_html(_readings_html(self._values), order=7.0)
        self._legend = gui.add_html(_legend_html(legend), order=8.0)

    def show_guide(self, said: Guide) -> None:
        """Headline and next step."""
        _set(self._state, _state_html(said))

    def show_depth(self, image: NDArray[np.uint8] | None, said: str) -> None:
        """Thumbnail (h, w, 3) and the text above it; None: nothing is seen now."""
        if image is None:
            if self._depth is not None:
                self._depth.visible = False
            self._depth_title.visible = False
            return
        _set(self._depth_title, f'<div style="{_SMALL};padding:0 1em">{html.escape(said)}</div>')
        self._depth_title.visible = True
        if self._depth is None:
            self._depth = self._gui.add_image(image, format='png', order=3.5)
        else:
            self._depth.image = image
            self._depth.visible = True

    def show_readings(self, values: Mapping[str, str]) -> None:
        """Rows of the table."""
        if unknown := values.keys() - self._values.keys():
            raise KeyError(*unknown)
        with self._lock:
            self._values |= values
            _set(self._readings, _readings_html(self._values))

    def show_answer(self, text: str) -> None:
        """What came of a button that was pressed; empty: nothing to tell."""
        _set(
            self._answer,
            f'<div style="padding:0 1em"><small class="answer">{html.escape(text)}</small></div>',
        )
        self._answer.visible = bool(text)

    def show_end(self, rows: Sequence[tuple[str, str]], links: Sequence[tuple[str, str]]) -> None:
        """Verdict of a scan that has ended: rows of a table, and addresses with their names."""
        found = ' · '.join(
            f'<a href="{html.escape(address)}" target="_blank" style="color:#7db8ff">{html.escape(name)}</a>'
            for address, name in links
        )
        _set(self._end, f'<div class="end" style="padding:0 1em">{_table(rows)}<div>{found}</div></div>')
        self._end.visible = bool(rows or links)
        if rows:
            self.show_depth(None, '')
        for group in self._buttons:
            group.visible = not rows

    def clear(self) -> None:
        """Start a new scan."""
        self.show_end((), ())
        self.show_answer('')
        self.show_depth(None, '')
        self.show_readings(dict.fromkeys(READINGS, ''))

    def _reset_twice(self) -> None:
        """Reset forgets the scan: it has to be pressed twice."""
        assert self._press is not None
        now = time.monotonic()
        if now - self._armed_s < CONFIRM_S:
            self._armed_s = -CONFIRM_S
            self._press(RESET)
        else:
            self._armed_s = now
            self.show_answer('Reset forgets this scan. Press it again to do so.')


def _set(handle: Any, content: str) -> None:
    if handle.content != content:
        handle.content = content


def _state_html(said: Guide) -> str:
    colour = COLOURS.get(said.state, COLOURS['waiting'])
    return (
        f'<div style="padding:0.3em 1em;border-left:0.4em solid rgb{colour}">'
        f'<div class="state" style="font-size:1.7em;font-weight:700;line-height:1.2;color:rgb{colour}">'
        f'{html.escape(said.state)}</div>'
        f'<div class="step" style="font-size:1.05em">{html.escape(said.step)}</div></div>'
    )


def _readings_html(values: Mapping[str, str]) -> str:
    return f'<div style="padding:0 1em">{_table([(k, v) for k, v in values.items() if v], "reading")}</div>'


def _table(rows: Sequence[tuple[str, str]], name: str = 'verdict') -> str:
    cells = ''.join(
        f'<tr><td style="opacity:0.7;padding-right:0.8em;vertical-align:top;white-space:nowrap">'
        f'{html.escape(title)}</td><td class="{name}" style="overflow-wrap:anywhere;white-space:pre-line">'
        f'{html.escape(text)}</td></tr>'
        for title, text in rows
    )
    return f'<table style="font-size:0.85em;border-collapse:collapse">{cells}</table>'


def _legend_html(legend: Iterable[tuple[Rgb, str]]) -> str:
    entries = ''.join(
        f'<span style="white-space:nowrap;margin-right:0.8em"><span style="display:inline-block;width:0.7em;'
        f'height:0.7em;border-radius:2px;background:rgb{colour}"></span> {html.escape(text)}</span> '
        for colour, text in legend
    )
    return f'<div class="legend" style="padding:0 1em;{_SMALL}">{entries}</div>'
