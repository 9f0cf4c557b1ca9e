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

"""The report as users meet it: one page, complete, from whatever a scan left."""

import json
import re
import shutil
from html.parser import HTMLParser

import pytest

from debris_scanner.cli.main import main

SECTIONS = (
    'Outcome', 'Model', 'Figures', 'Motion', 'Forecast', 'Similarity', 'Closures', 'Pose graph', 'Observer',
    'Timing', 'About',
)  # fmt: skip
PLOTS = {
    'model',
    'frames',
    'rate',
    'drift',
    'forecast',
    'likeness',
    'pairs',
    'spread',
    'graph-before',
    'graph-after',
    'track',
    'timing',
}


class Page(HTMLParser):
    """Elements of a page: links by navigation, plots, references to elsewhere, and its text."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.attributes, self.words, self._skip = [], [], [], False
        self.source = path.read_text(encoding='utf-8')
        self.feed(self.source)
        self.text = ' '.join(' '.join(self.words).split())

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or '') for name, value in attrs]
        self._skip = tag in ('script', 'style')

    def handle_endtag(self, tag):
        self._skip = self._skip and tag not in ('script', 'style')

    def handle_data(self, data):
        if not self._skip:
            self.words.append(data)

    def values(self, wanted_tag, wanted_name):
        return [v for tag, name, v in self.attributes if (tag, name) == (wanted_tag, wanted_name)]

    @property
    def plots(self):
        return set(self.values('script', 'data-for'))

    def raw_figure(self, key):
        return re.search(rf'data-for="{key}">(.*?)</script>', self.source, re.DOTALL).group(1)

    def figure(self, key):
        return json.loads(self.raw_figure(key))


def report(directory, *options):
    return main(['report', str(directory), *map(str, options)])


@pytest.fixture
def result(brief_result, tmp_path):
    shutil.copytree(brief_result, tmp_path / 'shuttle')
    return tmp_path / 'shuttle'


@pytest.fixture
def light(result):
    """The result without its meshes, whose thinning takes the longest."""
    (result / 'mesh.ply').unlink()
    (result / 'mesh_closed.ply').unlink()
    return result


@pytest.fixture(scope='module')
def page_file(session_result, tmp_path_factory):
    """The page of the whole result; only to be read."""
    out = tmp_path_factory.mktemp('page') / 'page.html'
    assert report(session_result, '--out', out) == 0
    return out


@pytest.fixture(scope='module')
def cylinder(tmp_path_factory):
    """A scan without a model."""
    folder = tmp_path_factory.mktemp('cylinder')
    assert main(['simulate', 'cylinder', '--seconds', '2', '--out', str(folder / 'bag')]) == 0
    assert main(['scan', str(folder / 'bag'), '--out', str(folder / 'cylinder')]) == 3
    return folder


def one_line(capsys, *words):
    err = capsys.readouterr().err
    assert err.count('\n') == 1, err
    assert err.startswith('debris-scan report: ')
    for word in words:
        assert str(word) in err


def test_page_is_complete_and_small(page_file):
    assert page_file.stat().st_size < 15e6
    page = Page(page_file)
    assert page.values('a', 'href') == [f'#{key}' for key in page.values('section', 'id')]
    for section in SECTIONS:
        assert section in page.text
    assert page.plots >= PLOTS
    assert page.tags.count('figcaption') == len(page.plots)
    assert page.text.count('Look for') >= len(PLOTS) - 1
    for words in ('Model found', '250', 'has not been compared with the truth'):
        assert words in page.text
    assert any(f'{period} s' in page.text for period in ('12.56', '12.57'))  # the true one is 12.566
    triangles = page.figure('model')['data'][0]
    assert triangles['type'] == 'mesh3d'
    assert page.text.count('accepted') >= 2


def test_page_weighs_little_before_the_models_own_data(page_file):
    page = Page(page_file)
    own = sum(len(page.raw_figure(key)) for key in ('model', 'track'))
    assert len(page.source.encode()) - own <= 2.5e6


def test_page_asks_nothing_of_the_network(page_file):
    page = Page(page_file)
    for tag, name, value in page.attributes:
        if name in ('src', 'href', 'srcset', 'action', 'data', 'poster', 'xlink:href'):
            assert value.startswith('#'), (tag, name, value)
    assert not {'link', 'iframe', 'object', 'embed', 'base', 'form'} & set(page.tags)
    own_style = page.source.split('<style>')[1].split('</style>')[0]
    assert 'url(' not in own_style and '@import' not in own_style
    policy = page.values('meta', 'content')[0]
    assert policy.startswith("default-src 'none';")
    assert 'http' not in policy
    # the library is there once, and nothing stands where a reader's HTML could end a script early
    assert page.values('script', 'id').count('library') == 1
    assert 'plotly.js v' not in page.source
    assert page.tags.count('script') == len(page.plots) + 2


def test_same_result_gives_the_same_page(page_file, session_result, tmp_path):
    assert report(session_result, '--out', tmp_path / 'page.html') == 0
    assert (tmp_path / 'page.html').read_bytes() == page_file.read_bytes()


def test_truth_is_evaluated_and_drawn(result, brief_bag, tmp_path, capsys):
    assert report(result, '--truth', brief_bag, '--out', tmp_path / 'page.html') == 0
    assert 'attitude error' in capsys.readouterr().out
    metrics = json.loads((result / 'metrics.json').read_text())
    assert not (result / 'report.html').exists()
    page = Page(tmp_path / 'page.html')
    assert f'{metrics["attitude_deg"]["median"]:.3f}' in page.text
    assert f'{100 * metrics["completeness"]:.1f} %' in page.text
    assert 'this outcome is right' in page.text
    names = {trace.get('name') for key in ('rate', 'drift') for trace in page.figure(key)['data']}
    assert {'truth', 'odometry against truth', 'final against truth'} <= names
    assert 'judged by the truth' in page.text


def test_earlier_metrics_are_shown_without_the_truth(light, capsys):
    (light / 'metrics.json').write_text(json.dumps({'verdict': 'right', 'why': 'as told', 'model_mm': None}))
    assert report(light) == 0
    assert str(light / 'report.html') in capsys.readouterr().out
    text = Page(light / 'report.html').text
    assert 'Judged by the truth, this outcome is right : as told' in text
    assert "judged by this scan's own final attitudes" in text  # the true ones are not in the folder
    for denial in ('no truth', 'not been compared with the truth', 'without truth'):
        assert denial not in text


def test_coverage_is_told_and_painted(page_file, session_result):
    told = json.loads((session_result / 'summary.json').read_text())['coverage']
    page = Page(page_file)
    assert f'{100 * told["observed_share"]:.0f} % of the closed surface was seen' in page.text
    names = [trace['name'] for trace in page.figure('model')['data']]
    assert names == ['seen', 'never seen, filled in', 'cloud']


def test_a_folder_without_a_closed_mesh_says_so(result):
    (result / 'mesh_closed.ply').unlink()
    assert report(result) == 0
    page = Page(result / 'report.html')
    assert 'This folder holds no closed mesh ( mesh_closed.ply )' in page.text
    assert [trace['name'] for trace in page.figure('model')['data']] == ['seen', 'cloud']


def test_a_turn_that_was_not_whole_is_told(light):
    content = json.loads((light / 'summary.json').read_text())
    content |= {'result': 'no_model', 'reason': 'no_closure', 'model': None}
    (light / 'summary.json').write_text(json.dumps(content))
    lines = (light / 'odometry.tum').read_text().splitlines()
    (light / 'odometry.tum').write_text('\n'.join(lines[:24]) + '\n')  # 23 sixths of a second at 1 rad/s
    assert report(light) == 0
    said = re.search(r'Turn on: (\d+)° of 360° seen\.', Page(light / 'report.html').text)
    assert 217 <= int(said.group(1)) <= 223


def test_no_model_is_explained(cylinder, capsys):
    assert report(cylinder / 'cylinder', '--truth', cylinder / 'bag') == 0
    page = Page(cylinder / 'cylinder' / 'report.html')
    for words in (
        'No model: the rotation of this target cannot be observed',
        'What to do.',
        'unobservable_rotation',
        'There is no model to turn.',
        'Fewer than two key frames were described',
        'No hypothesis was tried',
    ):
        assert words in page.text
    for section in SECTIONS:
        assert section in page.text
    assert page.plots == {'frames', 'rate', 'drift', 'track', 'timing'}


def test_closures_without_a_model_are_still_drawn(result):
    content = json.loads((result / 'summary.json').read_text())
    content |= {'result': 'no_model', 'reason': 'inconsistent_model', 'model': None}
    (result / 'summary.json').write_text(json.dumps(content))
    assert report(result) == 0
    page = Page(result / 'report.html')
    assert 'No model: the views contradict each other' in page.text
    assert {'likeness', 'pairs', 'graph-before', 'graph-after', 'track'} <= page.plots
    assert not {'model', 'drift'} & page.plots


def test_live_result_with_probabilities_shows_them(light):
    (light / 'logs').mkdir()
    assert report(light) == 0
    assert {'likeness', 'pairs'} <= Page(light / 'report.html').plots


def test_result_without_probabilities_says_so(result):
    (result / 'closure_probabilities.npz').unlink()
    assert report(result) == 0
    page = Page(result / 'report.html')
    assert 'closure_probabilities.npz is missing' in page.text
    assert page.plots == PLOTS - {'likeness', 'pairs', 'spread'}


def test_summary_alone_is_enough(result, tmp_path):
    (tmp_path / 'bare').mkdir()
    shutil.copy(result / 'summary.json', tmp_path / 'bare')
    assert report(tmp_path / 'bare') == 0
    page = Page(tmp_path / 'bare' / 'report.html')
    assert page.plots == {'timing'}
    assert 'no longer lies beside its summary' in page.text


def test_text_from_files_is_never_markup(light):
    content = json.loads((light / 'summary.json').read_text())
    hostile = '</script><img src=x onerror=alert(1)>'
    content['closures'][0]['why'] = content['versions'][hostile] = hostile
    content['timing'][hostile] = {'count': 1, 'p50_ms': 1.0, 'p99_ms': 2.0}
    content['frames']['rejected'] = {hostile: 3}
    (light / 'summary.json').write_text(json.dumps(content))
    assert report(light) == 0
    page = Page(light / 'report.html')
    assert 'img' not in page.tags
    assert hostile.replace('_', ' ') in page.text
    assert hostile in page.figure('timing')['data'][0]['y']
    assert '<' not in page.raw_figure('timing')


# bad input


def test_folder_without_a_scan(tmp_path, capsys):
    assert report(tmp_path) == 2
    one_line(capsys, tmp_path, 'summary.json')


def test_truth_that_is_not_there(result, tmp_path, capsys):
    assert report(result, '--truth', tmp_path) == 2
    one_line(capsys, 'truth.tum')


@pytest.mark.parametrize('opens', [True, False])
def test_the_page_is_opened_if_asked(light, monkeypatch, capsys, opens):
    opened = []
    monkeypatch.setattr('webbrowser.open', lambda url: opened.append(url) or opens)
    assert report(light, '--open') == 0
    assert opened == [(light / 'report.html').as_uri()]
    assert ('no browser opened' in capsys.readouterr().err) is not opens


@pytest.mark.parametrize('out', ['missing/page.html', '.'])
def test_page_that_cannot_be_written(result, tmp_path, capsys, out):
    assert report(result, '--out', tmp_path / out) == 2
    one_line(capsys, 'cannot write the page')


@pytest.mark.parametrize(
    ('name', 'content'),
    [
        ('summary.json', '{'),
        ('summary.json', '[]'),
        ('summary.json', '{"result": "model"}'),
        ('metrics.json', 'x'),
        ('rates.csv', 'stamp_ns\n1,2,3\n'),
        ('rates.csv', 'stamp_ns\n1,a,b,c,d,e,f,accepted\n'),
        ('graph.g2o', 'VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n'),
        ('graph.g2o', 'EDGE_SE3:QUAT 0 1\n'),
        ('target_pose.tum', '1 2 3\n'),
        ('closure_probabilities.npz', 'no zip'),
        ('mesh_closed.ply', 'no mesh'),
        ('model.ply', 'no cloud'),
    ],
)
def test_damaged_file_is_named_in_one_line(result, capsys, name, content):
    (result / name).write_text(content)
    assert report(result) == 2
    one_line(capsys, result)
    assert not (result / 'report.html').exists()
