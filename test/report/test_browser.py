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

"""The report in a real browser: nothing complains or is fetched, and the model is seen and turns."""

import base64
import re

import numpy as np
import pytest
from browser import CONTRASTS

from debris_scanner.cli.main import main
from debris_scanner.core.results import NO_CLOSURE
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.report.page import render
from debris_scanner.report.scan_output import read_scan

pytestmark = pytest.mark.slow
EYE = "(e => [e.x, e.y, e.z])(document.getElementById('model')._fullLayout.scene._scene.getCamera().eye)"
PHONE = {'width': 390, 'height': 844, 'phone': True}
SCROLLED = 'document.documentElement.scrollTop'
MIDDLE_OF = """(key => {{
    const r = document.getElementById(key).getBoundingClientRect();
    return [r.x + r.width / 2, r.y + r.height / 2];
}})('{}')"""


@pytest.fixture(scope='module')
def page(brief_result, tmp_path_factory):
    out = tmp_path_factory.mktemp('page') / 'report.html'
    assert main(['report', str(brief_result), '--out', str(out)]) == 0
    return out


def show(browser, page, **screen):
    """The page on such a screen; loaded anew only where a test has left it: a figure takes its time."""
    if browser.showing != (page, screen):
        browser.open(page, **screen)


@pytest.fixture
def opened(browser, page):
    """The page on a wide, light screen; each test puts back what it changes."""
    show(browser, page)
    return browser


def coloured(pixels, background):
    """Share of the pixels that differ clearly from the background."""
    return float((np.abs(pixels.astype(int) - background).max(axis=-1) > 40).mean())


def middle(pixels):
    h, w, _ = pixels.shape
    return pixels[h // 5 : -h // 5, w // 3 : -w // 3]


def to_model(browser):
    """Scroll to the model; the middle of it in the window."""
    browser.run("document.getElementById('model').scrollIntoView({block: 'center', behavior: 'instant'})")
    browser.settle()
    return browser.run(MIDDLE_OF.format('model'))


def turn_to(browser, label):
    buttons = "[...document.querySelectorAll('#model-section .views button')]"
    browser.run(f"{buttons}.find(b => b.textContent === '{label}').click()")
    browser.settle()


def hint(browser):
    return browser.run("document.querySelector('#model-section .hint').textContent")


def test_nothing_complains_and_nothing_is_fetched(opened, page):
    assert opened.complaints == []
    assert opened.requests[0] == page.resolve().as_uri()
    assert all(url.startswith(('data:', 'blob:')) for url in opened.requests[1:])
    assert opened.run("document.querySelectorAll('.plot.failed').length") == 0
    plots = opened.run("document.querySelectorAll('.plot').length")
    assert plots == opened.run("document.querySelectorAll('.plot .main-svg:first-child').length") >= 10
    assert 'cloud' not in opened.run(
        "[...document.querySelectorAll('.modebar-btn')].map(b => b.dataset.title).join().toLowerCase()"
    )


def test_model_is_seen_and_turns(opened):
    before = middle(opened.screenshot('model'))
    assert 0.15 < coloured(before, before[0, 0]) < 0.95
    x, y = opened.run(MIDDLE_OF.format('model'))
    opened.mouse(('moved', x, y), ('pressed', x, y), ('moved', x + 150, y), ('released', x + 150, y))
    after = middle(opened.screenshot('model'))
    assert coloured(after, before[0, 0]) > 0.1
    assert (np.abs(after.astype(int) - before).max(axis=-1) > 40).mean() > 0.05
    assert opened.complaints == []


def test_the_wheel_scrolls_past_the_model_until_it_is_clicked(opened):
    opened.hover(5, 5)  # an earlier test may have left it inside
    turn_to(opened, 'Reset')
    x, y = to_model(opened)
    eye, top = np.array(opened.run(EYE)), opened.run(SCROLLED)
    asleep = hint(opened)
    assert 'after a click' in asleep and 'Ctrl' in asleep
    opened.hover(x, y)
    opened.wheel(x, y, 120)
    assert opened.run(SCROLLED) > top + 50
    np.testing.assert_allclose(opened.run(EYE), eye)
    x, y = to_model(opened)
    top = opened.run(SCROLLED)
    opened.wheel(x, y, 120, ctrl=True)
    further = np.array(opened.run(EYE))
    assert np.linalg.norm(further) > 1.02 * np.linalg.norm(eye)
    opened.mouse(('pressed', x, y), ('released', x, y))
    assert hint(opened) != asleep
    opened.wheel(x, y, 120)
    assert np.linalg.norm(opened.run(EYE)) > 1.02 * np.linalg.norm(further)
    assert opened.run(SCROLLED) == top
    opened.hover(5, 5)
    assert hint(opened) == asleep
    turn_to(opened, 'Reset')
    np.testing.assert_allclose(opened.run(EYE), eye, atol=1e-6)
    assert opened.complaints == []


def test_buttons_turn_the_model_to_its_sides_and_back(opened):
    turn_to(opened, 'Reset')
    eye = opened.run(EYE)
    for label, axis, sign in (
        ('Front', 2, -1), ('Back', 2, 1), ('Left', 0, -1), ('Right', 0, 1), ('Top', 1, -1), ('Bottom', 1, 1),
    ):  # fmt: skip
        turn_to(opened, label)
        looks = np.array(opened.run(EYE))
        np.testing.assert_allclose(looks / np.linalg.norm(looks), sign * np.eye(3)[axis], atol=1e-3)
        shown = middle(opened.screenshot('model'))
        assert coloured(shown, shown[0, 0]) > 0.05, label
    turn_to(opened, 'Reset')
    np.testing.assert_allclose(opened.run(EYE), eye, atol=1e-6)


def test_the_slider_shows_the_pose_of_a_frame(opened):
    move = """(k => {{
        const s = document.getElementById('frame');
        s.value = k; s.dispatchEvent(new Event('input')); return document.getElementById('pose').textContent;
    }})({})"""
    first = opened.run(move.format(0))
    before = opened.screenshot('frames')
    later = opened.run(move.format(9))
    after = opened.screenshot('frames')
    assert first.startswith('1 of 45, a key frame: at 0.00 s') and '0.0° from' in first
    assert later.startswith('10 of 45') and 'at 1.50 s' in later
    turned = float(later.rsplit(', ', 1)[1].split('°')[0])
    assert turned == pytest.approx(np.degrees(1.5), abs=1)
    assert coloured(before, before[2, 2]) > 0.03
    assert (np.abs(after.astype(int) - before).max(axis=-1) > 40).mean() > 0.01
    opened.run(move.format(0))


def test_canvas_without_a_model_would_be_noticed(opened):
    opened.run("void Plotly.restyle('model', {visible: false})")
    opened.settle()
    blank = middle(opened.screenshot('model'))
    opened.run("document.querySelectorAll('#model-section .choices button')[0].click()")
    assert coloured(blank, blank[0, 0]) < 0.05


def test_mesh_gives_way_to_the_cloud(opened):
    mesh = middle(opened.screenshot('model'))
    opened.run("[...document.querySelectorAll('#model-section .choices button')].at(-2).click()")
    opened.settle()
    cloud = middle(opened.screenshot('model'))
    assert coloured(cloud, cloud[0, 0]) > 0.1
    assert (np.abs(cloud.astype(int) - mesh).max(axis=-1) > 40).mean() > 0.1
    assert opened.run("document.querySelector('#model-section [aria-pressed=true]').textContent") == 'Cloud'
    opened.run("document.querySelectorAll('#model-section .choices button')[0].click()")


def test_track_and_maps_are_seen(opened):
    for key, least in (('track', 0.01), ('pairs', 0.3), ('rate', 0.01), ('graph-before', 0.005)):
        pixels = opened.screenshot(key)
        assert coloured(pixels, pixels[2, 2]) > least, key


def test_click_into_the_map_selects_the_key_frame(opened):
    was = opened.run("document.querySelector('b[data-row]').textContent")
    opened.run("document.getElementById('pairs').scrollIntoView({block: 'center', behavior: 'instant'})")
    opened.settle()
    x, y = opened.run("""(() => {
        const d = document.getElementById('pairs'), l = d._fullLayout, r = d.getBoundingClientRect();
        return [r.x + l.xaxis._offset + l.xaxis.d2p(30), r.y + l.yaxis._offset + l.yaxis.d2p(7)];
    })()""")
    opened.mouse(('moved', x - 3, y), ('moved', x, y), ('pressed', x, y), ('released', x, y))
    opened.wait_for("document.querySelector('b[data-row]').textContent === '7'", 10)
    assert was != '7'
    values = opened.run("Array.from(document.getElementById('likeness').data[5].y)")
    assert values[7] == pytest.approx(1.0)
    assert max(values[:6] + values[9:]) < 1.0


def test_closures_sort_by_a_click(opened):
    column = (
        "[...document.querySelectorAll('#closures tbody tr')].map(r => parseFloat(r.cells[4].textContent))"
    )
    header = "document.querySelectorAll('#closures th button')[4].click()"
    opened.run(header)
    rising = opened.run(column)
    opened.run(header)
    falling = opened.run(column)
    assert len(rising) > 2
    assert rising == sorted(rising)
    assert falling == sorted(rising, reverse=True)
    assert rising[0] != rising[-1]


def covering_legends(browser):
    """Plots whose legend lies over their curves."""
    return browser.run("""[...document.querySelectorAll('.plot:not(.scene)')].filter((div) => {
        const legend = div.querySelector('.legend');
        if (!legend) return false;
        const a = legend.getBoundingClientRect();
        return [...div.querySelectorAll('.nsewdrag')].some((drag) => {
            const b = drag.getBoundingClientRect();
            return a.left < b.right && b.left < a.right && a.top < b.bottom - 1 && b.top < a.bottom - 1;
        });
    }).map((div) => div.id)""")


def test_legends_lie_beside_the_curves(opened):
    assert covering_legends(opened) == []


def test_text_stands_out_from_what_is_behind_it(browser, page):
    """Contrast by WCAG 2.1 of the small coloured texts, at least 4.5."""
    small = '.badge, .hint, .small, figcaption, .choices button, .views button, .slider output, nav a'
    add_samples = """(() => {
        const box = Object.assign(document.createElement('div'), { id: 'samples' });
        box.innerHTML = '<span class="badge good">a</span><span class="badge bad">b</span>'
            + '<div class="verdict good"><p class="small">c</p></div>'
            + '<div class="verdict bad"><p class="small">d</p></div>';
        document.querySelector('.scroll td').append(box);
    })()"""
    for screen in ({}, {'dark': True}):
        show(browser, page, **screen)
        browser.run(add_samples)
        found = browser.run(f"{CONTRASTS}('{small}')")
        browser.run("document.getElementById('samples').remove()")
        assert len(found) > 20
        assert [f for f in found if f[1] < 4.5] == []


def test_dark_and_light(browser, page):
    show(browser, page, dark=True)
    dark = browser.screenshot('rate')
    browser.run("document.getElementById('theme').click()")
    browser.showing = None
    browser.settle()
    browser.wait_for(
        "getComputedStyle(document.querySelector('#rate .xtick text')).fill === 'rgb(91, 102, 118)'"
    )
    light = browser.screenshot('rate')
    assert np.median(dark) < 60
    assert np.median(light) > 230
    assert browser.complaints == []


def test_it_prints_on_two_sheets_however_many_closures_there_are(opened):
    opened.run("""(row => {
        for (let k = 0; k < 40; k++) row.after(Object.assign(row.cloneNode(true), { className: 'copy' }));
    })(document.querySelector('#closures tbody tr'))""")
    printed = base64.b64decode(opened.call('Page.printToPDF', preferCSSPageSize=True)['data'])
    opened.run("document.querySelectorAll('#closures .copy').forEach(row => row.remove())")
    assert len(re.findall(rb'/Type\s*/Page\b', printed)) == 2


def test_phone_needs_no_sideways_scrolling(browser, page):
    show(browser, page, **PHONE)
    assert browser.run('document.documentElement.scrollWidth') <= 390
    for key in ('model', 'track'):
        width, height = browser.run(
            f"(r => [r.width, r.height])(document.getElementById('{key}').getBoundingClientRect())"
        )
        assert height == pytest.approx(width, rel=0.02)
    shown = middle(browser.screenshot('model'))
    assert coloured(shown, shown[0, 0]) > 0.1
    assert browser.complaints == []


def test_legends_lie_beside_the_curves_on_a_phone(browser, page):
    show(browser, page, **PHONE)
    assert covering_legends(browser) == []


def test_a_finger_scrolls_past_the_model_until_it_is_tapped(browser, page):
    show(browser, page, **PHONE)
    x, y = to_model(browser)
    eye, top = browser.run(EYE), browser.run(SCROLLED)
    browser.swipe(x, y, 150)
    assert browser.run(SCROLLED) > top + 50
    np.testing.assert_allclose(browser.run(EYE), eye)
    x, y = to_model(browser)
    browser.tap(x, y)
    browser.rest()
    assert browser.run("document.getElementById('model').classList.contains('awake')")
    top = browser.run(SCROLLED)
    browser.swipe(x, y, 100)
    assert browser.run(SCROLLED) == top
    assert np.abs(np.array(browser.run(EYE)) - eye).max() > 0.05
    assert browser.complaints == []


def test_a_browser_that_cannot_unpack_the_library_says_so(browser, page):
    script = browser.call(
        'Page.addScriptToEvaluateOnNewDocument', source='delete window.DecompressionStream;'
    )['identifier']
    browser.open(page)
    browser.call('Page.removeScriptToEvaluateOnNewDocument', identifier=script)
    browser.showing = None
    assert browser.run("document.querySelectorAll('.plot:not(.failed)').length") == 0
    assert 'need a newer browser' in browser.run("document.getElementById('model').textContent")
    assert 'Model found' in browser.run('document.body.innerText')


def test_complaints_would_be_noticed(browser, tmp_path):
    script = (
        "document.documentElement.dataset.ready = 'yes'; console.error('alas'); new Image().src = 'x.png';"
    )
    (tmp_path / 'bad.html').write_text(f'<!doctype html><script>{script} throw new Error("oh")</script>')
    browser.open(tmp_path / 'bad.html')
    said = str(browser.complaints)
    assert 'alas' in said and 'oh' in said and 'x.png' in said
    assert browser.requests[-1].endswith('x.png')


def test_page_of_an_empty_scan(browser, tmp_path):
    write_results(tmp_path / 'none', ScanResult(NO_CLOSURE, None, frames_read=0), 1.0)
    (tmp_path / 'none.html').write_text(render(read_scan(tmp_path / 'none')))
    browser.open(tmp_path / 'none.html')
    assert browser.complaints == []
    assert 'no whole turn was seen' in browser.run('document.body.innerText')
