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

"""Headless Chromium driven through its DevTools pipe: what a reader's browser shows, says and asks for."""

import base64
import contextlib
import fcntl
import io
import itertools
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
from PIL import Image

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
FLAGS = (
    '--headless', '--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync', '--disable-dev-shm-usage', '--hide-scrollbars',
    '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--remote-debugging-pipe',
)  # fmt: skip

# Name and contrast by WCAG 2.1 of each text that a selector finds; what is translucent lets shine through.
CONTRASTS = """(selector => {
    const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
    const light = (c) => c.slice(0, 3).map((v) => v / 255)
        .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
    const behind = (e) => {
        const c = rgb(getComputedStyle(e).backgroundColor);
        return c.length === 4 && c[3] === 0 && e.parentElement ? behind(e.parentElement) : c;
    };
    const opacity = (e) => e ? getComputedStyle(e).opacity * opacity(e.parentElement) : 1;
    return [...document.querySelectorAll(selector)].map((e) => {
        const back = behind(e), share = opacity(e);
        const text = rgb(getComputedStyle(e).color).map((v, k) => share * v + (1 - share) * back[k]);
        const [a, b] = [light(text), light(back)];
        return [e.className || e.textContent, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
    });
})"""


def find_chromium():
    """Path of the browser, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def _pipe():
    """Reading and writing end, both well above the descriptors that the browser is to have them on."""
    ends = os.pipe()
    high = tuple(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in ends)
    for end in ends:
        os.close(end)
    return high


class BrowserError(Exception):
    """The browser answered with an error, or not at all."""


class Browser:
    """One page in one browser; `complaints` collects console errors, exceptions and policy violations."""

    def __init__(self, path, profile):
        """Start the browser of that path with a new profile in an empty folder."""
        to_browser, self._commands = _pipe()
        self._answers, from_browser = _pipe()
        self._error = (Path(profile).parent / 'browser.log').open('w')
        # the browser reads commands on descriptor 3 and writes answers on 4
        plumbing = f'exec 3<&{to_browser} 4>&{from_browser}; exec "$0" "$@"'
        self._process = subprocess.Popen(
            ['/bin/bash', '-c', plumbing, path, *FLAGS, f'--user-data-dir={profile}', 'about:blank'],
            pass_fds=(to_browser, from_browser), stdout=subprocess.DEVNULL, stderr=self._error,
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._ids, self._pending, self._session = itertools.count(1), b'', None
        self.complaints, self.requests, self.showing = [], [], None
        targets = self.call('Target.getTargets')['targetInfos']
        page = next(t['targetId'] for t in targets if t['type'] == 'page')
        self._session = self.call('Target.attachToTarget', targetId=page, flatten=True)['sessionId']
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.call(f'{domain}.enable')

    def close(self):
        """End the browser."""
        with contextlib.suppress(BrowserError, OSError):
            self._session = None
            self.call('Browser.close')
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._commands)
        os.close(self._answers)
        self._error.close()

    def call(self, method, **params):
        """Send a command and return its result; events that come meanwhile are noted."""
        number = next(self._ids)
        message = {'id': number, 'method': method, 'params': params}
        if self._session:
            message['sessionId'] = self._session
        os.write(self._commands, json.dumps(message).encode() + b'\0')
        deadline = time.monotonic() + 60
        while True:
            answer = self._next(deadline)
            if answer.get('id') == number:
                if 'error' in answer:
                    raise BrowserError(f'{method}: {answer["error"]}')
                return answer['result']
            self._note(answer)

    def _next(self, deadline):
        while b'\0' not in self._pending:
            ready, _, _ = select.select([self._answers], [], [], max(0, deadline - time.monotonic()))
            chunk = os.read(self._answers, 1 << 20) if ready else b''
            if not chunk:
                raise BrowserError('the browser does not answer')
            self._pending += chunk
        message, self._pending = self._pending.split(b'\0', 1)
        return json.loads(message)

    def _note(self, event):
        method, params = event.get('method'), event.get('params', {})
        if method == 'Runtime.exceptionThrown':
            self.complaints.append(params['exceptionDetails'])
        elif method == 'Runtime.consoleAPICalled' and params['type'] in ('error', 'assert'):
            self.complaints.append(params['args'])
        elif method == 'Log.entryAdded' and params['entry']['level'] == 'error':
            self.complaints.append(params['entry'])
        elif method == 'Network.requestWillBeSent':
            self.requests.append(params['request']['url'])

    def run(self, expression):
        """Value of a JavaScript expression, awaited."""
        answer = self.call('Runtime.evaluate', expression=expression, returnByValue=True, awaitPromise=True)
        if 'exceptionDetails' in answer:
            raise BrowserError(str(answer['exceptionDetails']))
        return answer['result'].get('value')

    def wait_for(self, expression, seconds=60):
        """Until the expression is true."""
        deadline = time.monotonic() + seconds
        while not self.run(expression):
            if time.monotonic() > deadline:
                raise BrowserError(f'never true: {expression}')
            time.sleep(0.1)

    def open(self, path, **screen):
        """Load a report and wait until all its figures are drawn; see `_screen` for the rest."""
        self.visit(Path(path).resolve().as_uri(), **screen)
        self.wait_for("document.documentElement?.dataset.ready === 'yes'")
        self.settle()
        self.showing = (path, screen)

    def visit(self, url, **screen):
        """Go to a page."""
        self.showing = None
        self._screen(**screen)
        self.complaints.clear()
        self.requests.clear()
        self.call('Page.navigate', url=url)

    def _screen(self, width=1280, height=900, dark=False, phone=False):
        self.call(
            'Emulation.setDeviceMetricsOverride',
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=phone,
        )
        theme = [{'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}]
        self.call('Emulation.setEmulatedMedia', features=theme)

    def settle(self):
        """Let what has been drawn reach the screen."""
        self.run(
            'new Promise(f => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(f, 300))))'
        )

    def screenshot(self, element=None):
        """Pixels (h, w, 3) of the element of that id, scrolled into view, or of the whole page."""
        options = {}
        if element:
            rect = f'document.getElementById({element!r})'
            self.run(f'{rect}.scrollIntoView({{block: "center", behavior: "instant"}})')
            self.settle()
            corner = '(r => ({x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height}))'
            box = self.run(f'{corner}({rect}.getBoundingClientRect())')
            options = {'clip': {**box, 'scale': 1}}
        shot = self.call('Page.captureScreenshot', captureBeyondViewport=element is None, **options)
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(shot['data']))).convert('RGB'))

    def mouse(self, *steps):
        """Mouse events (kind, x, y) in the window's pixels: pressed, moved, released."""
        for kind, x, y in steps:
            name = {'pressed': 'mousePressed', 'moved': 'mouseMoved', 'released': 'mouseReleased'}[kind]
            self.call('Input.dispatchMouseEvent', type=name, x=x, y=y, button='left', buttons=1, clickCount=1)
            self.settle()

    def hover(self, x, y):
        """Move the mouse with no button held."""
        self.call('Input.dispatchMouseEvent', type='mouseMoved', x=x, y=y)
        self.settle()

    def key(self, name):
        """Press and release a key: Tab, Enter or Space."""
        code, text = {'Tab': (9, ''), 'Enter': (13, '\r'), 'Space': (32, ' ')}[name]
        key = ' ' if name == 'Space' else name
        event = {'key': key, 'code': name, 'windowsVirtualKeyCode': code}
        self.call('Input.dispatchKeyEvent', type='keyDown', text=text, **event)
        self.call('Input.dispatchKeyEvent', type='keyUp', **event)

    def wheel(self, x, y, down, ctrl=False):
        """Turn the wheel by so many pixels at a place of the window."""
        held = 2 if ctrl else 0
        self.call(
            'Input.dispatchMouseEvent', type='mouseWheel', x=x, y=y, deltaX=0, deltaY=down, modifiers=held
        )
        self.settle()

    def swipe(self, x, y, up):
        """Move one finger up by so many pixels, on a screen that is touched."""
        self.call('Emulation.setTouchEmulationEnabled', enabled=True)
        for step in range(11):
            kind = 'touchMove' if step else 'touchStart'
            self.call('Input.dispatchTouchEvent', type=kind, touchPoints=[{'x': x, 'y': y - up * step / 10}])
        time.sleep(0.2)  # a finger that rests before it lifts: without a throw, the page stays where it is
        self.call('Input.dispatchTouchEvent', type='touchMove', touchPoints=[{'x': x, 'y': y - up}])
        self.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])
        self.settle()
        self.rest()
        self.call('Emulation.setTouchEmulationEnabled', enabled=False)

    def rest(self, patience=10.0):
        """Wait until the page no longer scrolls."""
        end, before = time.monotonic() + patience, None
        while (top := self.run('document.documentElement.scrollTop')) != before:
            assert time.monotonic() < end, f'the page still scrolls after {patience:g} s'
            before = top
            self.settle()

    def tap(self, x, y):
        """Touch a place of the window briefly."""
        self.call('Emulation.setTouchEmulationEnabled', enabled=True)
        self.call('Input.dispatchTouchEvent', type='touchStart', touchPoints=[{'x': x, 'y': y}])
        self.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])
        self.settle()
        self.call('Emulation.setTouchEmulationEnabled', enabled=False)
