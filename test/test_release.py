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

"""What a release needs: the API's pages and the declarations."""

import importlib
import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest

import debris_scanner

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_the_pages_of_the_api_are_built_without_a_warning(tmp_path):
    pytest.importorskip('sphinx', reason='no Sphinx here')
    # read and resolved, not written as HTML: no warning comes of that
    command = [sys.executable, '-m', 'sphinx', '-b', 'dummy', '-q', '-W', '--keep-going', 'docs']
    done = subprocess.run([*command, tmp_path], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    tree = pickle.loads((tmp_path / '.doctrees/api/debris_scanner/debris_scanner.doctree').read_bytes())
    assert 'debris_scanner.scanner.Scanner' in tree.astext().replace('\n', '')
    assert 'Takes depth frames, estimates the target' in tree.astext()


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
