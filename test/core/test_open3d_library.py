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

"""Open3D is found, also without the system's libusb."""

import importlib
import subprocess
import sys
from types import SimpleNamespace

import pytest

from debris_scanner.core import open3d_library
from debris_scanner.core.open3d_library import load_open3d

LIBUSB = ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')


class Modules:
    """Stands in for the import system: each name gives its modules or errors in turn."""

    def __init__(self, **answers):
        self.answers = answers

    def __call__(self, name):
        answer = self.answers[name].pop(0)
        if isinstance(answer, ImportError):
            raise answer
        return answer


@pytest.fixture
def imports(monkeypatch):
    def use(**answers):
        monkeypatch.setattr(open3d_library.importlib, 'import_module', Modules(**answers))

    return use


def test_open3d_is_the_real_one():
    assert load_open3d() is importlib.import_module('open3d')


def test_a_missing_libusb_is_taken_from_the_package(imports, monkeypatch):
    loaded = []
    monkeypatch.setattr(open3d_library.ctypes, 'CDLL', lambda path, mode: loaded.append(path))
    package = SimpleNamespace(get_library_path=lambda: '/somewhere/libusb-1.0.so')
    imports(open3d=[LIBUSB, 'open3d'], libusb_package=[package])
    assert load_open3d() == 'open3d'
    assert loaded == ['/somewhere/libusb-1.0.so']


def test_without_either_the_message_says_what_to_install(imports):
    imports(open3d=[LIBUSB], libusb_package=[ImportError('no such module')])
    with pytest.raises(ImportError, match=r'libusb-1\.0-0.*pip install libusb-package'):
        load_open3d()


def test_other_failures_pass_through(imports):
    imports(open3d=[ImportError("No module named 'open3d'")])
    with pytest.raises(ImportError, match="No module named 'open3d'"):
        load_open3d()


def test_its_plots_are_loaded_when_one_is_drawn():
    code = (
        'import sys\n'
        'from debris_scanner.core.open3d_library import load_open3d\n'
        'o3d = load_open3d()\n'
        'print("dash" in sys.modules)\n'
        'box = o3d.geometry.TriangleMesh.create_box()\n'
        'print(type(o3d.visualization.get_plotly_fig([box])).__name__, "dash" in sys.modules)\n'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ['False', 'Figure', 'True']
