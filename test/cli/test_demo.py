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

"""``debris-scan demo``: which scan it runs, when it opens a page, and the picture it leaves."""

import numpy as np
import pytest
from PIL import Image

from debris_scanner.cli import demo
from debris_scanner.cli.main import main
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.sim.targets import make_target


@pytest.fixture
def asked(monkeypatch):
    """The options that the live scan is asked for; it leaves a mesh, and ends with the code that is set."""

    class Asked:
        code = 0

        def run(self, args):
            self.args = args
            args.out.mkdir(parents=True)
            target = make_target('cubesat')
            write_mesh_ply(args.out / 'mesh.ply', target.vertices, target.triangles)
            return self.code

    scan = Asked()
    monkeypatch.setattr(demo.live, 'run', scan.run)
    for name in ('DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(name, raising=False)
    return scan


def test_it_leaves_a_picture_of_the_model_and_names_it(asked, tmp_path, capsys):
    assert main(['demo', '--out', str(tmp_path / 'out')]) == 0
    assert asked.args.simulate == demo.TARGET
    assert asked.args.view is None  # nobody could see it
    picture = tmp_path / 'out' / 'model.png'
    assert str(picture) in capsys.readouterr().out
    pixels = np.asarray(Image.open(picture)).astype(int)
    background = np.abs(pixels - pixels[0, 0]).max(axis=2) < 3
    assert 0.2 < background.mean() < 0.9  # each of three sides shows the target before a background
    assert all((~third).mean() > 0.1 for third in np.split(background, 3, axis=1))


def test_it_opens_the_page_where_there_is_a_screen(asked, tmp_path, monkeypatch):
    pytest.importorskip('viser')
    monkeypatch.setenv('DISPLAY', ':0')
    assert main(['demo', '--out', str(tmp_path / 'seen')]) == 0
    assert (asked.args.view, asked.args.open) == (0, True)
    assert main(['demo', '--no-view', '--out', str(tmp_path / 'unseen')]) == 0
    assert asked.args.view is None


def test_a_scan_without_a_model_has_no_picture(asked, tmp_path):
    asked.code = 3
    assert main(['demo', '--out', str(tmp_path / 'out')]) == 3
    assert not (tmp_path / 'out' / 'model.png').exists()


def test_a_page_is_opened_once(monkeypatch):
    from debris_scanner.cli.live import view

    class Running:
        def running(self, name):
            return True

    class Told:
        def value(self, node, key):
            return 'http://127.0.0.1:1'

    opened = []
    monkeypatch.setattr(view.webbrowser, 'open', lambda url: opened.append(url) or True)
    page = view.LiveView(Running(), opens=True)
    assert 'in the browser' in page.news(Told())
    assert page.news(Told()) == ''
    assert opened == ['http://127.0.0.1:1']
