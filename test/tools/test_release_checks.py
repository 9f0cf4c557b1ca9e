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

"""What `make release` asks: versions, change log, licences; and that a failed check is told."""

import json
import re
import sys

import pytest

from debris_scanner import __version__
from tools import licences, release
from tools.dist import ROOT
from tools.release import NotReady, changes

LOG = """\
# Changelog

## [Unreleased]

## [1.2.3] - 2026-01-31

### Added

- A thing.
"""


def test_all_files_state_one_version():
    assert set(release.versions().values()) == {__version__}
    assert release.tag() == f'v{__version__}'


def test_the_change_log_is_in_form():
    """What is gathered above the newest version is for the next one."""
    text = (ROOT / 'CHANGELOG.md').read_text()
    assert len(text.splitlines()) <= release.MOST_LINES
    assert changes(re.sub(r'(## \[Unreleased\]\n).*?(?=^## )', r'\1\n', text, flags=re.S | re.M), __version__)


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('## [Unreleased]\n', '## [Unreleased]\n\n### Fixed\n\n- More.\n', r'still \[Unreleased\]'),
        ('## [Unreleased]\n', '', 'first sections'),
        ('[1.2.3] - 2026-01-31', '1.2.3', 'newest section'),
        ('1.2.3', '1.2.2', 'newest section'),
        ('2026-01-31', '2026-02-31', 'no date'),
        ('Added', 'News', 'not those of Keep a Changelog'),
        ('- A thing.', '- A thing.\n' * 200, 'lines, more than'),
    ],
)
def test_a_change_log_that_is_not_ready(old, new, said):
    assert '- A thing.' in changes(LOG, '1.2.3')
    with pytest.raises(NotReady, match=said):
        changes(LOG.replace(old, new), '1.2.3')


def test_the_checks_run_one_by_one_and_a_failure_is_told(monkeypatch, tmp_path, capsys):
    done = []

    def failing(log):
        raise NotReady('no reason')

    def missing(log):
        raise release.Skipped('no program')

    monkeypatch.setattr(release, 'OUT', tmp_path)
    monkeypatch.setattr(release, 'ROOT', tmp_path)
    monkeypatch.setattr(release, 'CHECKS', {'a': failing, 'b': missing, 'c': lambda log: done.append('c')})
    assert not release.check(['a', 'b', 'c'])
    assert done == ['c']
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ['FAIL', 'skip', 'ok']
    assert 'no reason (a.log)' in lines[0]
    assert release.check(['b', 'c'])


def test_checks_are_listed_chosen_and_left_out(monkeypatch, tmp_path, capsys):
    chosen = []
    monkeypatch.setattr(release, 'DIST', tmp_path)
    (tmp_path / 'some.deb').write_text('package')
    monkeypatch.setattr(release, 'check', lambda names: chosen.append(names) or True)
    for arguments in (
        ['--only', 'version,tree'],
        ['--skip', ','.join([*list(release.CHECKS)[1:]])],
        ['--list'],
    ):
        monkeypatch.setattr(sys, 'argv', ['release', *arguments])
        assert release.main() == 0
    assert chosen == [['tree', 'version'], ['tree']]
    assert (tmp_path / 'SHA256SUMS').read_text().endswith('  some.deb\n')
    told = capsys.readouterr().out
    assert all(name in told for name in release.CHECKS)
    assert f'git tag -s v{__version__}' in told  # a person does that
    assert 'placeholder' in told or release.PLACEHOLDER not in (ROOT / 'package.xml').read_text()
    monkeypatch.setattr(sys, 'argv', ['release', '--only', 'trea'])
    with pytest.raises(SystemExit):
        release.main()


def test_a_scorecard_with_a_broken_case_or_more_wrong_models_is_not_ready():
    def cases(*outcomes):
        return {f'case{k}': {'outcome': outcome} for k, outcome in enumerate(outcomes)}

    old = {'version': '1.2.2', 'cases': cases('wrong model', 'right')}
    for ready in (
        cases('right', 'wrong model'),
        cases('right', 'right', 'wrong model'),
    ):  # the last one is new
        release.no_worse([old, {'version': '1.2.3', 'cases': ready}], '1.2.3')
    with pytest.raises(NotReady, match=r'2 wrong models .* 1 in that of 1\.2\.2'):
        release.no_worse([old, {'version': '1.2.3', 'cases': cases('wrong model', 'wrong model')}], '1.2.3')
    with pytest.raises(NotReady, match='broke at case1'):
        release.no_worse([old, {'version': '1.2.3', 'cases': cases('right', 'error')}], '1.2.3')
    release.no_worse([old], '1.2.2')


def test_a_stranger_has_nothing_but_a_home_and_a_search_path(tmp_path, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', '/somewhere')
    with (tmp_path / 'log').open('w') as log:
        release.run(log, 'env', home=tmp_path)
    told = dict(line.split('=', 1) for line in (tmp_path / 'log').read_text().splitlines()[1:])
    assert told['HOME'] == str(tmp_path) and 'PATH' in told and 'PYTHONPATH' not in told


def test_the_page_of_licences_names_all_pins():
    pinned = licences.pins((ROOT / 'constraints.txt').read_text())
    page = (ROOT / 'docs' / 'licences.md').read_text()
    assert licences.rows(page).keys() == pinned.keys()
    assert page == licences.render(pinned, licences.rows(page))


def test_what_is_installed_states_its_licence():
    assert licences.licence_of('numpy').startswith('BSD-3-Clause')
    assert licences.licence_of('mypy') == 'MIT'
    assert licences.licence_of('nobody-has-this') is None
    bill = json.loads(licences.bill({'numpy': '2'}, {'numpy': 'BSD'}))
    assert bill['components'][0]['purl'] == 'pkg:pypi/numpy@2'
