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

"""The scene in a real browser: nothing complains or is fetched, what is drawn is seen, and boxes hide it."""

import time

import numpy as np
import pytest
from browser import CONTRASTS

from debris_scanner.core.geometry import exp_se3
from debris_scanner.viewer.drawing import by_direction, lit
from debris_scanner.viewer.guidance import Guide
from debris_scanner.viewer.panel import COLOURS, CONFIRM_S, READINGS
from debris_scanner.viewer.scene import Layer, ScanScene
from debris_scanner.viewer.server import open_server, url_of

pytestmark = pytest.mark.slow
SCANNING, TRACKING = 'target_scanning', 'target'
FIELDS = "[...document.querySelectorAll('.reading')].map(e => e.textContent)"
STATE, STEP = ("document.querySelector('.state').textContent", "document.querySelector('.step').textContent")
# viser's own settings come first
BOXES = "[...document.querySelectorAll('input[type=checkbox]')].slice(-7)"
BUTTONS = "[...document.querySelectorAll('button')]"


@pytest.fixture
def server():
    made = open_server(port=0)
    yield made
    made.stop()


@pytest.fixture
def scene(server):
    return ScanScene(server, (SCANNING, TRACKING))


def ball():
    """Points (n, 3) and normals of a ball of 0.12 m about the origin."""
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return (normals * 0.12).astype(np.float32), normals.astype(np.float32)


def pose(z=0.8):
    T = exp_se3(np.array([0.0, 0.4, 0.0, 0, 0, 0]))
    T[2, 3] = z
    return T


def ring():
    angle = np.linspace(0, 5, 20)
    return np.stack([0.8 * np.sin(angle), 0 * angle, -0.8 * np.cos(angle)], axis=1).astype(np.float32)


def fill(scene, frame=TRACKING):
    """Everything there is to be drawn."""
    points, normals = ball()
    seen = points + np.float32([0, 0, 0.8])
    front = normals[:, 2] < 0
    scene.show_target(seen[front], lit(seen[front], normals[front]))
    nodes = ring()
    lines = np.stack([nodes[:-1], nodes[1:]], axis=1)
    scene.show_graph(frame, nodes, lines, lines[:1])
    scene.show_model(frame, points, by_direction(normals))
    scene.show_mesh(frame, points[:3], np.array([[0, 1, 2]], np.int32))
    scene.show_pose(frame, pose())
    scene.panel.show_guide(Guide('tracking', 'turn <b id="markup">on</b>'))
    scene.show_readings({'Frames': '120', 'Remark': '<b id="markup">{1+1}</b>'})


def drawn(browser):
    """Share of the picture, panel aside, that is not background."""
    pixels = browser.screenshot()[200:, :780].astype(int)
    return float((np.abs(pixels - 26).max(axis=-1) > 40).mean())


def until(browser, condition, what, seconds=30):
    end = time.monotonic() + seconds
    while not condition(share := drawn(browser)):
        assert time.monotonic() < end, f'{what}: {share:.4f} is drawn'
        time.sleep(0.3)
    return share


def visit(browser, server):
    browser.visit(url_of(server), width=1100, height=700)
    browser.wait_for("document.querySelector('canvas') !== null")


def test_all_is_drawn_and_nothing_complains_or_is_fetched(browser, server, scene):
    fill(scene)
    visit(browser, server)
    until(browser, lambda share: share > 0.03, 'a picture')
    browser.wait_for(f"{FIELDS}.includes('120')")
    browser.wait_for(f"{STATE} === 'tracking'")
    assert browser.run(STEP) == 'turn <b id="markup">on</b>'
    assert browser.run('document.title') == 'debris_scanner: live scan'
    assert browser.run(f'{BOXES}.map(box => box.checked)') == [True, True, False, True, True, False, False]
    assert browser.run("document.getElementById('markup')") is None
    assert browser.run(f'{FIELDS}.includes(\'<b id="markup">{{1+1}}</b>\')')
    assert browser.complaints == []
    address = url_of(server)
    assert all(url.startswith((address, 'data:', f'blob:{address}')) for url in browser.requests)


def test_boxes_hide_what_they_name_and_a_new_scan_hides_all(browser, server, scene):
    visit(browser, server)
    until(browser, lambda share: share < 0.02, 'an empty scene')
    fill(scene)
    full = until(browser, lambda share: share > 0.03, 'what came after the page')
    browser.run(f'{BOXES}[0].click()')
    less = until(browser, lambda share: share < 0.8 * full, 'the scene without the target')
    browser.run(f'{BOXES}[2].click()')
    until(browser, lambda share: share > less + 0.01, "the model's cloud")
    scene.clear()
    until(browser, lambda share: share < 0.02, 'an empty scene')
    browser.wait_for(f"!{FIELDS}.includes('120')")
    assert browser.complaints == []


def test_a_later_cloud_takes_the_place_of_an_earlier_one(server, scene):
    points, normals = ball()
    for count in (100, 4000, 10, 0, 50):
        scene.show_target(points[:count], by_direction(normals[:count]))
        layer = scene._layers['Target now'].drawn
        assert (len(layer['points'].points) if count else len(layer)) == count


def test_a_ghost_shows_the_model_where_it_is_expected(server, scene):
    ghost = scene._layers['In ten seconds'].drawn
    scene.show_forecast(pose())  # without a model there is nothing to show
    assert not ghost
    points, normals = ball()
    scene.show_model(TRACKING, points, by_direction(normals))
    for z in (0.9, 1.1):
        scene.show_forecast(pose(z))
        assert len(ghost['points'].points) == len(points)
        np.testing.assert_allclose(ghost['points'].position, [0, 0, z])
        assert not ghost['points'].visible  # until its box is ticked
    scene.clear()
    assert not ghost


def test_a_box_shows_all_that_its_layer_has_drawn(server):
    layer = Layer(server.gui.add_checkbox('Layer', False))
    for key in ('a', 'b'):
        layer.add(key, lambda key=key: server.scene.add_frame(f'/{key}'))
    handles = list(layer.drawn.values())
    assert [handle.visible for handle in handles] == [False, False]
    layer.box.value = True
    until_true(lambda: all(handle.visible for handle in handles), 'both')
    for _ in range(2):
        layer.drop('a')
        assert list(layer.drawn.values()) == handles[1:]
    layer.empty()
    assert not layer.drawn


def test_the_axes_are_those_of_all_frames(scene):
    scene._layers['Axes'].box.value = True
    until_true(lambda: all(f.show_axes for f in (scene._sensor, *scene._frames.values())), 'axes')


def test_only_the_frame_of_the_last_pose_is_shown(server, scene):
    for frame in (SCANNING, TRACKING, TRACKING, SCANNING):
        scene.show_pose(frame, pose())
        assert {name for name, handle in scene._frames.items() if handle.visible} == {frame}


def test_a_target_held_still_lets_the_sensor_go_round(server, scene):
    scene.show_target(ball()[0] + np.float32([0, 0, 0.8]), by_direction(ball()[1]))
    scene._still.value = 'target'
    placed = []
    for z in (0.7, 0.9):
        scene.show_pose(TRACKING, pose(z))
        placed.append((scene._frames[TRACKING].position.copy(), scene._sensor.position.copy()))
    assert np.allclose(placed[0][0], placed[1][0])
    assert np.isclose(np.linalg.norm(placed[0][1] - placed[1][1]), 0.2)


def test_a_coloured_model_shows_its_cloud(server, scene):
    points, normals = ball()
    scene.show_model(TRACKING, points, by_direction(normals))
    assert not scene._layers['Model cloud'].drawn['points'].visible
    scene.show_model(TRACKING, points, by_direction(normals), seen=True)
    assert scene._layers['Model cloud'].drawn['points'].visible
    scene.show_model(TRACKING, points[:0], by_direction(normals[:0]))
    assert not scene._layers['Model cloud'].drawn


def test_readings_are_all_known(server, scene):
    scene.show_readings(dict.fromkeys(READINGS, 'said'))
    with pytest.raises(KeyError):
        scene.show_readings({'Unheard of': '1'})


def press(browser, name):
    browser.wait_for(f"{BUTTONS}.some(b => b.textContent === '{name}')")
    browser.run(f"{BUTTONS}.find(b => b.textContent === '{name}').click()")


def test_buttons_press_what_they_name_and_reset_asks_first(browser, server):
    pressed = []
    scene = ScanScene(server, (SCANNING, TRACKING), pressed.append)
    visit(browser, server)
    for name in ('Generate', 'Save', 'Finish', 'Pause', 'Resume'):
        press(browser, name)
        until_true(lambda name=name: pressed[-1:] == [name], name)
    press(browser, 'Reset')
    browser.wait_for("document.querySelector('.answer')?.textContent.startsWith('Reset forgets')")
    assert pressed[-1] == 'Resume'
    press(browser, 'Reset')
    until_true(lambda: pressed[-1] == 'Reset', 'the second press')
    assert CONFIRM_S < 10
    assert not scene._layers['Key frames'].drawn


FOCUSED = """(e => [e.textContent, e.type,
    e.matches(':focus-visible') && getComputedStyle(e).outlineStyle])(document.activeElement)"""


def test_all_that_can_be_clicked_is_reached_and_pressed_from_the_keyboard(browser, server):
    pressed = []
    scene = ScanScene(server, (SCANNING, TRACKING), pressed.append)
    visit(browser, server)
    browser.wait_for(f'{BOXES}.length === 7')
    browser.settle()
    wanted, reached = ['Generate', 'Save', 'Finish', 'Pause', 'Resume'], 0
    for _ in range(40):
        browser.key('Tab')
        text, kind, outline = browser.run(FOCUSED)
        if text in wanted:
            assert outline == 'solid', text
            browser.key('Enter')
            until_true(lambda text=text: pressed[-1:] == [text], text)
            wanted.remove(text)
        elif kind == 'checkbox':
            box = list(scene._layers.values())[reached].box
            before = box.value
            browser.key('Space')
            until_true(lambda box=box, before=before: box.value != before, f'layer {reached}')
            reached += 1
        if not wanted and reached == 7:
            break
    assert (wanted, reached) == ([], 7)


def test_texts_stand_out_from_what_is_behind_them(browser, server):
    scene = ScanScene(server, (SCANNING, TRACKING), lambda _: None)
    scene.show_readings({'Frames': '120'})
    scene.panel.show_answer('Saved.')
    scene.panel.show_end([('result', 'model')], [('/files/report.html', 'report.html')])
    visit(browser, server)
    browser.wait_for("document.querySelector('.end a') !== null")
    for state, colour in COLOURS.items():
        scene.panel.show_guide(Guide(state, 'turn on'))
        browser.wait_for(f"{STATE} === '{state}'")
        found = browser.run(
            f"{CONTRASTS}('.state, .step, .reading, .verdict, .answer, .end a, .legend > span')"
        )
        assert len(found) > 10
        assert [f for f in found if f[1] < 4.5] == [], colour


def test_a_page_without_controls_has_no_buttons(browser, server, scene):
    visit(browser, server)
    browser.wait_for("document.querySelector('.state') !== null")
    assert not browser.run(f"{BUTTONS}.some(b => ['Finish', 'Reset', 'Pause'].includes(b.textContent))")


def until_true(condition, what, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def test_the_end_has_a_verdict_and_links_as_text(browser, server, scene):
    visit(browser, server)
    scene.panel.show_end([('result', '<i id="markup">model</i>')], [('/files/report.html', 'report.html')])
    browser.wait_for("document.querySelector('.end a') !== null")
    assert browser.run("document.querySelector('.end a').getAttribute('href')") == '/files/report.html'
    assert browser.run("document.getElementById('markup')") is None


@pytest.mark.parametrize(('width', 'height', 'phone'), [(700, 600, False), (390, 800, True)])
def test_state_and_step_fit_a_narrow_window_and_a_phone(browser, server, scene, width, height, phone):
    fill(scene)
    browser.visit(url_of(server), width=width, height=height, phone=phone)
    browser.wait_for("document.querySelector('.state') !== null")
    browser.settle()
    box = "(r => [r.left, r.right, r.top, r.bottom])(document.querySelector('{}').getBoundingClientRect())"
    for part in ('.state', '.step'):
        left, right, top, bottom = browser.run(box.format(part))
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
