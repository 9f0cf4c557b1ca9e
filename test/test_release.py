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

"""What a release needs: a changelog that catkin's tools read, the API's pages, the declarations."""

import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import debris_scanner

ROOT = Path(__file__).resolve().parents[1]


def changelog_rst():
    spec = importlib.util.spec_from_file_location('changelog_rst', ROOT / 'docs' / 'changelog_rst.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_markdown_comes_through():
    text = (
        '# Changelog\n\nNewest first.\n\n## Unreleased\n\n- **New**: `a*b`s [here](x.md).\n  - a | b\n\n'
        '## 1.2.3 (2026-01-02)\n\n- [Site](https://a.b)\n'
    )
    assert changelog_rst().converted(text).splitlines()[3:] == [
        '',
        'Forthcoming',
        '-----------',
        '* New: ``a*b``\\ s here.',
        '  * a \\| b',
        '',
        '1.2.3 (2026-01-02)',
        '------------------',
        '* `Site <https://a.b>`__',
    ]


def test_released_changes_are_the_same_in_both_files():
    """Forthcoming ones are carried over by ``make changelog`` before a release."""
    made, kept = (
        changelog_rst().converted((ROOT / 'CHANGELOG.md').read_text()),
        (ROOT / 'CHANGELOG.rst').read_text(),
    )
    released = [re.split(r'(?=^\d+\.\d+\.\d+ \()', text, flags=re.MULTILINE)[1:] for text in (made, kept)]
    assert released[0] == released[1], 'make changelog'
    assert kept.splitlines()[:3] == made.splitlines()[:3]


def test_catkins_tools_read_the_changelog(tmp_path):
    changelog = pytest.importorskip('catkin_pkg.changelog', reason='no catkin_pkg here')
    path = tmp_path / 'CHANGELOG.rst'
    markdown = (ROOT / 'CHANGELOG.md').read_text().replace('## Unreleased', '## 1.0.0 (2026-12-01)')
    path.write_text(changelog_rst().converted(markdown))
    read = changelog.get_changelog_from_path(str(path))
    ((version, _, (content,)),) = read.foreach_version()
    assert version == debris_scanner.__version__
    assert len(content.bullets) == markdown.count('\n- ')


@pytest.mark.slow
def test_the_pages_of_the_api_are_built_without_a_warning(tmp_path):
    pytest.importorskip('sphinx', reason='no Sphinx here')
    command = [sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', 'docs', str(tmp_path / 'api')]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / 'api' / 'api' / 'debris_scanner' / 'debris_scanner.html').read_text()
    assert 'debris_scanner.scanner.Scanner' in page
    assert 'Takes depth frames, estimates the target' in page


def test_the_declared_api_exists():
    text = (ROOT / 'docs' / 'api' / 'public.md').read_text()
    for module, names in (
        ('debris_scanner', debris_scanner.__all__),
        ('debris_scanner.io.result_files', ('write_results', 'check_output_dir')),
        ('debris_scanner.io.trajectories', ('read_tum', 'write_tum')),
        ('msg_adapters.bags', ('open_session',)),
        ('msg_adapters.bag_writer', ('BagWriter',)),
    ):
        for name in names:
            assert hasattr(importlib.import_module(module), name)
            assert name in text
    (example,) = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    compile(example, 'example', 'exec')


def test_declarations_name_files_that_exist():
    for name in ('QUALITY_DECLARATION.md', 'SECURITY.md', 'docs/api/public.md', 'docs/install.md'):
        path = ROOT / name
        for target in re.findall(r'\]\((?!https?:)([^)#]+)', path.read_text()):
            assert (path.parent / target).exists(), f'{name}: {target}'
