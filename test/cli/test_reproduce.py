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

"""``debris-scan reproduce``: the quick form end to end, resuming, and bad usage."""

import json
import re

import numpy as np
import pytest
from PIL import Image

from debris_scanner.cli.main import main
from debris_scanner.research.reproduce.methods import METHODS, OTHER_SEARCH
from debris_scanner.research.reproduce.scores import COLUMNS

pytestmark = pytest.mark.slow

EXPECTED = {
    'experiment_1': (*(f'4.{k:02d}' for k in range(1, 11)), '5.01', '5.02'),
    'experiment_3': ('4.07', '4.08', '4.15', '4.17', '4.18', '5.01', '5.02'),
    'heuristics': ('5.04', '5.05', '5.06', '5.07', '5.08', '5.09'),
}


@pytest.fixture(scope='module')
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp('reproduce') / 'results'
    assert main(['reproduce', '--out', str(folder), '--experiments', '3,1', '--quick']) == 0
    return folder


def test_every_figure_is_there_and_shows_something(out):
    for folder, numbers in EXPECTED.items():
        names = sorted(p.name for p in (out / folder).glob('figure_*.png'))
        assert {n.split('_')[1] for n in names} == set(numbers), folder
        for name in names:
            pixels = np.asarray(Image.open(out / folder / name).convert('L'), np.float64)
            assert min(pixels.shape) > 200, name
            assert (pixels < 200).mean() > 0.002, f'{name} is blank'


def test_the_table_has_a_line_a_method(out):
    content = json.loads((out / 'table.json').read_text())
    assert list(content['experiments']) == ['1', '3']
    assert content['quick'] is True
    for key, experiment in content['experiments'].items():
        # section 4.4 compares the two ways of searching
        assert list(experiment['methods']) == [*METHODS[:2], *[OTHER_SEARCH] * (key == '3'), METHODS[2]]
        for line in experiment['methods'].values():
            assert set(COLUMNS) <= set(line)
            assert line['verdict'] in ('right', 'wrong')
            assert line['wall_s'] > 0
        assert experiment['methods']['odometry_only']['closures'] == 0
    assert content['similarities']['float']['entropy_bits'] > 1
    text = (out / 'table.md').read_text()
    assert text.count('| odometry only |') == text.count('| ours |') == 2
    assert 'Short sequences' in text
    for title in COLUMNS.values():
        assert title in text


def test_closing_the_loop_beats_odometry(out):
    methods = json.loads((out / 'table.json').read_text())['experiments']['1']['methods']
    assert methods['odometry_only']['attitude_max_deg'] > methods['thesis']['attitude_max_deg']
    assert methods['odometry_only']['model_rmse_mm'] > methods['ours']['model_rmse_mm']
    assert methods['odometry_only']['drift_deg'] > 5


def test_greedy_search_accepts_more_than_frugal(out):
    methods = json.loads((out / 'table.json').read_text())['experiments']['3']['methods']
    assert methods['thesis']['closures'] == 1
    assert methods[OTHER_SEARCH]['closures'] > 10


def test_the_index_shows_all_figures_in_the_thesis_order(out):
    page = (out / 'index.html').read_text()
    shown = re.findall(r'src="([^"]+)"', page)
    drawn = {p.relative_to(out).as_posix() for p in out.glob('*/figure_*.png')}
    assert set(shown) == drawn
    assert len(shown) == len(drawn)
    numbers = [tuple(map(int, n.split('.'))) for n in re.findall(r'<b>Thesis ([\d.]+),', page)]
    assert numbers == sorted(numbers)


def test_each_method_leaves_what_a_scan_leaves(out):
    for method in METHODS:
        folder = out / 'experiment_1' / method
        assert json.loads((folder / 'metrics.json').read_text())['verdict'] in ('right', 'wrong')
        assert (folder / 'model.ply').stat().st_size > 1000
    assert (out / 'experiment_1' / 'truth' / 'truth.tum').is_file()


def test_what_is_done_is_not_run_again(out, monkeypatch, capsys):
    def refuse(*_):
        raise AssertionError('an experiment was started')

    monkeypatch.setattr('debris_scanner.research.reproduce.tasks.Engine', refuse)
    before = (out / 'table.md').read_text()
    assert main(['reproduce', '--out', str(out), '--experiments', '1,3', '--quick']) == 0
    assert (out / 'table.md').read_text() == before
    assert 'odometry only' in capsys.readouterr().out
    # the long form of the same experiment is another result
    with pytest.raises(AssertionError, match='started'):
        main(['reproduce', '--out', str(out), '--experiments', '1'])


def test_a_failed_experiment_is_named_and_leaves_nothing(tmp_path, capsys):
    (tmp_path / '.experiment_1.part').write_text('in the way')
    assert main(['reproduce', '--out', str(tmp_path), '--experiments', '1', '--quick']) == 2
    err = capsys.readouterr().err
    assert 'experiment 1' in err
    assert 'Traceback' not in err
    assert not (tmp_path / 'experiment_1').exists()
    assert not (tmp_path / 'table.md').exists()


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--experiments', '1,9'], 'no experiment 9'),
        (['--experiments', ','], 'choose of'),
        (['--jobs', '0'], '--jobs must be at least 1'),
    ],
)
def test_bad_usage_is_one_line(tmp_path, capsys, options, said):
    assert main(['reproduce', '--out', str(tmp_path / 'out'), *options]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count('\n') == 1
    assert not (tmp_path / 'out').exists()
