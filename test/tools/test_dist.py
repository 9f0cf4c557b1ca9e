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

"""Sdist, wheel and Debian package: the same bytes again, complete, and of use without a clone."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from debris_scanner import __version__
from tools import debian, dist

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (dist.ROOT / '.git').exists(), reason='no git: sources of a release'),
]


@pytest.fixture(scope='module')
def built(tmp_path_factory):
    """Sdist and wheel of these sources, and the folder of their checksums."""
    folder = tmp_path_factory.mktemp('dist')
    return *dist.build(folder), folder


@pytest.fixture(scope='module')
def installed(built, tmp_path_factory):
    """An environment with the wheel, and for what it needs a path to this one's libraries."""
    home = tmp_path_factory.mktemp('stranger')
    venv.create(home, with_pip=False)
    python = home / 'bin' / 'python'
    # --no-deps and a .pth file: what the wheel lacks shows, and nothing is fetched
    command = [
        sys.executable,
        '-m',
        'pip',
        '--python',
        python,
        'install',
        '--no-deps',
        '--no-index',
        built[1],
    ]
    subprocess.run([*command, '--quiet', '--no-compile'], check=True)
    version = f'python{sys.version_info.major}.{sys.version_info.minor}'
    site = home / 'lib' / version / 'site-packages'
    (site / 'libraries.pth').write_text(sysconfig.get_path('purelib'))
    return home


def test_a_second_build_makes_the_same_bytes(built, tmp_path):
    """Of files of another date and another umask, in another folder."""
    _, _, first = built
    clone = tmp_path / 'clone'
    for name in subprocess.check_output(['git', 'ls-files', '-z'], cwd=dist.ROOT, text=True).split('\0'):
        if (dist.ROOT / name).is_file():
            (clone / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(dist.ROOT / name, clone / name)
            (clone / name).chmod(0o700 if os.access(dist.ROOT / name, os.X_OK) else 0o600)
    shutil.copytree(dist.ROOT / '.git', clone / '.git', symlinks=True)
    dist.build(tmp_path / 'again', clone)
    sums = [(folder / dist.SUMS).read_text() for folder in (first, tmp_path / 'again')]
    assert sums[0] == sums[1]
    done = subprocess.run(['sha256sum', '-c', dist.SUMS], cwd=first, capture_output=True, check=False)
    assert done.returncode == 0


def test_the_sdist_has_no_owner_and_one_date(built):
    with tarfile.open(built[0]) as archive:
        members = archive.getmembers()
    assert {m.mtime for m in members} == {dist.epoch()}
    assert {(m.uid, m.gid, m.uname) for m in members} == {(0, 0, '')}
    names = {m.name.partition('/')[2] for m in members}
    assert {'README.md', 'LICENSE', 'CHANGELOG.md', 'constraints.txt', 'package.xml', 'setup.py'} <= names
    assert not any(name.startswith(('test/', '.git', 'out/')) for name in names)


def test_the_wheel_has_what_nodes_and_launch_files_need(built):
    names = zipfile.ZipFile(built[1]).namelist()
    data = {n.partition('.data/data/')[2] for n in names}
    share = 'share/debris_scanner'
    for pattern, place in (
        ('launch/*.launch.py', share),
        ('params/*.yaml', share),
        ('rviz/*', share),
        ('scripts/*', 'lib/debris_scanner'),
    ):
        found = {p.name if 'lib' in place else f'{p.parent.name}/{p.name}' for p in dist.ROOT.glob(pattern)}
        assert {f'{place}/{name}' for name in found} <= data
    assert {f'{share}/package.xml', 'share/ament_index/resource_index/packages/debris_scanner'} <= data
    assert not any(n.startswith(('benchmarks/', 'tools/', 'test/')) for n in names)


def test_the_wheel_works_in_an_empty_folder(installed, tmp_path):
    """No clone, no make, and no sources beside it."""
    environment = {n: v for n, v in os.environ.items() if n not in ('PYTHONPATH', 'AMENT_PREFIX_PATH')}
    command = installed / 'bin' / 'debris-scan'

    def run(*arguments):
        return subprocess.run(
            arguments, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout

    assert run(command, '--version') == f'debris-scan {__version__}\n'
    assert 'usage: debris-scan demo' in run(command, 'demo', '--help')
    assert '10 frames' in run(command, 'simulate', 'cubesat', '--seconds', '1', '--out', 'bag')
    where = run(installed / 'bin' / 'python', '-c', 'import debris_scanner as d; print(d.__file__)')
    assert Path(where.strip()).is_relative_to(installed)


@pytest.mark.skipif(shutil.which('dpkg-deb') is None, reason='no dpkg-deb')
def test_the_debian_package_lies_where_jazzy_lies(built, tmp_path):
    package = debian.build(built[1], tmp_path)
    listed = subprocess.check_output(['dpkg-deb', '--contents', package], text=True).splitlines()
    modes = {line.split()[5].removeprefix('./'): (line.split()[0], line.split()[1]) for line in listed}
    assert modes['opt/ros/jazzy/lib/debris_scanner/graph'] == ('-rwxr-xr-x', 'root/root')
    assert modes['opt/ros/jazzy/share/debris_scanner/launch/scan.launch.py'] == ('-rw-r--r--', 'root/root')
    assert 'opt/ros/jazzy/lib/python3.12/site-packages/debris_scanner/__init__.py' in modes
    needs = subprocess.check_output(['dpkg-deb', '--field', package, 'Depends'], text=True)
    manifest = ET.parse(dist.ROOT / 'package.xml').getroot()
    wanted = {k for k in debian.keys_of(manifest) if debian.is_ros(k)}
    assert {f'ros-jazzy-{key.replace("_", "-")}' for key in wanted} <= set(needs.strip().split(', '))
    assert 'pip' not in needs


def test_a_key_that_rosdep_lacks_is_an_error():
    manifest = ET.fromstring('<package><exec_depend>python3-nobody-has-this</exec_depend></package>')
    with pytest.raises(KeyError):
        list(debian.depends(manifest, debian.known()))
