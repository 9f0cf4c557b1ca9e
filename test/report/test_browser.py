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

import numpy as np
import pytest

from debris_scanner.cli.main import main
from debris_scanner.core.results import NO_CLOSURE, ScanResult
from debris_scanner.io.result_files import write_results
from debris_scanner.report.page import render
from debris_scanner.report.scan_output import read_scan

pytestmark = pytest.mark.slow
MIDDLE_OF = """(key => {{
    const r = document.getElementById(key).getBoundingClientRect();
    return [r.x + r.width / 2, r.y + r.height / 2];
}})('{}')"""


@pytest.fixture(scope='module')
def page(session_result, tmp_path_factory):
    out = tmp_path_factory.mktemp('page') / 'report.html'
    assert main(['report', str(session_result), '--out', str(out)]) == 0
    return out


@pytest.fixture
def opened(browser, page):
    """The page on a wide, light screen; loaded anew only where a test has left it, so each puts back."""
    if browser.showing != (page, {}):
        browser.open(page)
    return browser


def coloured(pixels, background):
    """Share of the pixels that differ clearly from the background."""
    return float((np.abs(pixels.astype(int) - background).max(axis=-1) > 40).mean())


def middle(pixels):
    h, w, _ = pixels.shape
    return pixels[h // 5 : -h // 5, w // 3 : -w // 3]


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


def test_complaints_would_be_noticed(browser, tmp_path):
    script = (
        "document.documentElement.dataset.ready = 'yes'; console.error('alas'); new Image().src = 'x.png';"
    )
    (tmp_path / 'bad.html').write_text(f'<!doctype html><script>{script} throw new Error("oh")</script>')
    browser.open(tmp_path / 'bad.html')
    said = str(browser.complaints)
    assert 'alas' in said and 'oh' in said and 'x.png' in said
    assert browser.requests[-1].endswith('x.png')


def test_model_is_seen_and_turns(opened):
    before = middle(opened.screenshot('model'))
    assert 0.15 < coloured(before, before[0, 0]) < 0.95
    x, y = opened.run(MIDDLE_OF.format('model'))
    opened.mouse(('moved', x, y), ('pressed', x, y), ('moved', x + 150, y), ('released', x + 150, y))
    after = middle(opened.screenshot('model'))
    assert coloured(after, before[0, 0]) > 0.1
    assert (np.abs(after.astype(int) - before).max(axis=-1) > 40).mean() > 0.05
    assert opened.complaints == []


def test_canvas_without_a_model_would_be_noticed(opened):
    opened.run("void Plotly.restyle('model', {visible: [false, false]})")
    opened.settle()
    blank = middle(opened.screenshot('model'))
    opened.run("void Plotly.restyle('model', {visible: [true, false]})")
    assert coloured(blank, blank[0, 0]) < 0.05


def test_mesh_gives_way_to_the_cloud(opened):
    mesh = middle(opened.screenshot('model'))
    opened.run("document.querySelectorAll('#model-section .choices button')[1].click()")
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


def test_dark_and_light(browser, page):
    browser.open(page, dark=True)
    dark = browser.screenshot('rate')
    browser.run("document.getElementById('theme').click()")
    browser.settle()
    browser.wait_for(
        "getComputedStyle(document.querySelector('#rate .xtick text')).fill === 'rgb(91, 102, 118)'"
    )
    light = browser.screenshot('rate')
    assert np.median(dark) < 60
    assert np.median(light) > 230
    assert browser.complaints == []


def test_phone_needs_no_sideways_scrolling(browser, page):
    browser.open(page, width=390, height=844, phone=True)
    assert browser.run('document.documentElement.scrollWidth') <= 390
    shown = middle(browser.screenshot('model'))
    assert coloured(shown, shown[0, 0]) > 0.1
    assert browser.complaints == []


def test_page_of_an_empty_scan(browser, tmp_path):
    write_results(tmp_path / 'none', ScanResult(NO_CLOSURE, None, frames_read=0), 1.0)
    (tmp_path / 'none.html').write_text(render(read_scan(tmp_path / 'none')))
    browser.open(tmp_path / 'none.html')
    assert browser.complaints == []
    assert 'never came round again' in browser.run('document.body.innerText')
