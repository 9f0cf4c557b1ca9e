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

"""What is compiled once for all processes, and where it is kept."""

import os
import subprocess
import sys
import time

import pytest

from debris_scanner import kernel_cache
from debris_scanner.kernel_cache import VARIABLE, cache_folder, choose_cache, compile_once

COMPILER = """
import sys, time
from pathlib import Path
from debris_scanner.kernel_cache import compile_once
folder = Path(sys.argv[1])
def run():
    alone = folder / 'running'
    compiled = (folder / 'kernel').exists()
    assert compiled or not alone.exists(), 'two compile at once'
    if not compiled:
        alone.touch()
        time.sleep(0.5)
        (folder / 'kernel').touch()
        alone.unlink()
        print('compiled')
compile_once(folder, run)
"""


def test_of_several_processes_one_compiles_and_says_so(tmp_path):
    processes = [
        subprocess.Popen([sys.executable, '-c', COMPILER, str(tmp_path)], stdout=-1, stderr=-1, text=True)
        for _ in range(3)
    ]
    said = [p.communicate(timeout=120) for p in processes]
    assert [p.returncode for p in processes] == [0, 0, 0], said
    assert sorted(out for out, _ in said) == ['', '', 'compiled\n']
    assert sum('compiling, once on this machine' in err for _, err in said) == 1


def test_nobody_waits_for_what_is_compiled(tmp_path):
    ran = []
    compile_once(tmp_path, lambda: ran.append(1))
    with kernel_cache._alone(tmp_path):  # somebody compiles something else
        began_s = time.monotonic()
        compile_once(tmp_path, lambda: ran.append(2))
        assert time.monotonic() - began_s < 5.0
    assert ran == [1, 2]


def test_what_fails_to_compile_is_tried_again(tmp_path):
    def fail():
        raise ValueError('no compiler')

    with pytest.raises(ValueError, match='no compiler'):
        compile_once(tmp_path, fail)
    ran = []
    compile_once(tmp_path, lambda: ran.append(1))
    assert ran == [1]


def test_a_part_is_compiled_alone_and_all_of_it_with_the_rest(tmp_path):
    ran = []
    compile_once(tmp_path, lambda: ran.append('part'), part='part')
    compile_once(tmp_path, lambda: ran.append('all'), lambda: ran.append('load'))
    compile_once(tmp_path, lambda: ran.append('other'), lambda: ran.append('load'), part='other')
    assert ran == ['part', 'all', 'load']


def test_another_processor_compiles_anew(tmp_path, monkeypatch, capsys):
    compile_once(tmp_path, lambda: None)
    monkeypatch.setattr(kernel_cache, '_processor', lambda: 'another')
    compile_once(tmp_path, lambda: None)
    assert capsys.readouterr().err.count('compiling') == 2


@pytest.fixture
def unset(monkeypatch):
    monkeypatch.setenv(VARIABLE, '')  # so that it is put back afterwards
    monkeypatch.delenv(VARIABLE)
    return monkeypatch


def test_a_package_that_can_be_written_keeps_its_own(unset, tmp_path):
    choose_cache(tmp_path)
    assert VARIABLE not in os.environ
    assert cache_folder() == kernel_cache.PACKAGE / '__pycache__'


def test_one_that_cannot_shares_the_users_folder_or_that_for_temporary_files(unset, tmp_path):
    unset.setattr(kernel_cache, '_can_write', lambda folder: folder == tmp_path)
    unset.setenv('XDG_CACHE_HOME', str(tmp_path))
    choose_cache(tmp_path / 'package')
    assert cache_folder().parent == tmp_path and cache_folder().is_dir()
    unset.delenv(VARIABLE)
    unset.setattr(kernel_cache, '_can_write', lambda folder: False)
    choose_cache(tmp_path / 'package')
    assert os.environ[VARIABLE].startswith(kernel_cache.tempfile.gettempdir())


def test_a_folder_that_the_user_has_set_stays(unset, tmp_path):
    unset.setenv(VARIABLE, str(tmp_path / 'mine'))
    unset.setattr(kernel_cache, '_can_write', lambda folder: False)
    choose_cache()
    assert cache_folder() == tmp_path / 'mine'
