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

"""``python -m tools.debian``: a Debian package ros-jazzy-debris-scanner of the wheel, by dpkg-deb.

It lies where the packages of ROS 2 Jazzy on Ubuntu 24.04 lie, /opt/ros/jazzy with Python 3.12, and depends on
what package.xml names. What rosdep has from pip alone, or not at all, no Debian package can depend on: the
package says after its installation how to get it. Bloom, which needs the network, makes the same from the
same manifest.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import textwrap
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import yaml

from tools import dist
from tools.dist import ROOT

NAME = 'ros-jazzy-debris-scanner'
PREFIX = Path('opt/ros/jazzy')
PACKAGES = PREFIX / 'lib/python3.12/site-packages'
KEYS = Path(__file__).with_name('rosdep_keys.yaml')
EXTRA = "'numba>=0.60' 'open3d>=0.19' 'rosbags<0.12' 'trimesh>=4.5' 'plotly>=6.1' lz4 backports.zstd"
_CONTROL = """\
Package: {name}
Version: {version}-0noble
Architecture: all
Maintainer: {maintainer}
Section: misc
Priority: optional
Depends: {depends}
Description: {summary}
{rest}
"""
_POSTINST = f"""\
#!/bin/sh
set -e
[ "$1" = configure ] || exit 0
echo '{NAME}: what has no Debian package comes from pip, into an environment that sees ROS:'
echo "  python3 -m venv --system-site-packages VENV && VENV/bin/pip install {EXTRA}"
"""


def keys_of(manifest: ET.Element, kinds: Sequence[str] = ('depend', 'exec_depend')) -> list[str]:
    """The keys that a manifest names as dependencies of some kinds."""
    return [element.text or '' for kind in kinds for element in manifest.iterfind(kind)]


def known() -> dict[str, dict[str, list[str]]]:
    """The keys that are no package of ROS, and what installs each on Ubuntu 24.04."""
    found: dict[str, dict[str, list[str]]] = yaml.safe_load(KEYS.read_text())
    return found


def is_ros(key: str) -> bool:
    """Whether a key is the name of a package of ROS: those of systems have a hyphen."""
    return '-' not in key


def depends(manifest: ET.Element, rules: Mapping[str, Mapping[str, list[str]]]) -> Iterator[str]:
    """Names of the Debian packages that a manifest's run-time dependencies are.

    Raises:
        KeyError: a key that rosdep does not have.
    """
    for key in keys_of(manifest):
        if is_ros(key):
            yield f'ros-jazzy-{key.replace("_", "-")}'
        else:
            yield from rules[key].get('apt', [])


def build(wheel: Path, out: Path) -> Path:
    """Pack the wheel's files for /opt/ros/jazzy; returns the package."""
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    person = manifest.find('maintainer')
    assert person is not None
    version = manifest.findtext('version', '')
    summary, *rest = textwrap.wrap(manifest.findtext('description', ''), 70)
    with tempfile.TemporaryDirectory() as folder:
        root, control = Path(folder), Path(folder, 'DEBIAN')
        for installed, content, mode in _files(wheel):
            path = root / installed
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            path.chmod(mode)
        control.mkdir()
        text = _CONTROL.format(
            name=NAME,
            version=version,
            maintainer=f'{person.text} <{person.get("email")}>',
            depends=', '.join(['python3 (>= 3.12)', 'libusb-1.0-0', *depends(manifest, known())]),
            summary=summary,
            rest='\n'.join(f' {line}' for line in rest),
        )
        (control / 'control').write_text(text)
        (control / 'postinst').write_text(_POSTINST)
        (control / 'postinst').chmod(0o755)
        root.chmod(0o755)
        package = out / f'{NAME}_{version}-0noble_all.deb'
        subprocess.run(
            ['dpkg-deb', '--root-owner-group', '--build', root, package],
            env=os.environ | {dist.EPOCH: str(dist.epoch())},
            stdout=subprocess.DEVNULL,
            check=True,
            umask=0o022,
        )
    return package


def _files(wheel: Path) -> Iterator[tuple[Path, bytes, int]]:
    """Where each file of a wheel goes, below /, its content and its permissions."""
    with zipfile.ZipFile(wheel) as archive:
        for entry in archive.infolist():
            top, _, inner = entry.filename.partition('/')
            mode = 0o755 if (entry.external_attr >> 16) & 0o100 else 0o644
            place = (
                PREFIX / inner.removeprefix('data/') if top.endswith('.data') else PACKAGES / entry.filename
            )
            yield place, archive.read(entry), mode
    # where `ros2 run debris_scanner debris-scan` and a shell that sourced ROS find it
    for place in (PREFIX / 'bin/debris-scan', PREFIX / 'lib/debris_scanner/debris-scan'):
        code = 'import sys\n\nfrom debris_scanner.cli.main import main\n\nsys.exit(main())\n'
        yield place, f'#!/usr/bin/env python3\n{code}'.encode(), 0o755


def check(package: Path) -> None:
    """Unpack it by dpkg into a root of its own, and run it there with what this environment has.

    Raises:
        subprocess.CalledProcessError: dpkg, the command line or a node's wrapper failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / 'var/lib/dpkg').mkdir(parents=True)
        (root / 'var/lib/dpkg/status').touch()
        options = [f'--root={root}', '--force-not-root', '--force-depends', '--force-script-chrootless']
        subprocess.run(['dpkg', *options, '--install', package], check=True, stderr=subprocess.STDOUT)
        prefix = root / PREFIX
        there = {'PYTHONPATH': str(root / PACKAGES), 'AMENT_PREFIX_PATH': str(prefix), 'PYTHONSAFEPATH': '1'}
        path = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
        environment = os.environ | there | {'PATH': path}
        commands: tuple[list[str | Path], ...] = (
            [prefix / 'bin/debris-scan', '--version'],
            [
                prefix / 'lib/debris_scanner/debris-scan',
                'simulate',
                'cubesat',
                '--seconds',
                '1',
                '--out',
                'bag',
            ],
            [sys.executable, '-c', _LOOK],
        )
        for command in commands:
            subprocess.run(command, cwd=root, env=environment, check=True)


_LOOK = """\
import debris_scanner
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from pathlib import Path
prefix = Path(get_package_prefix('debris_scanner'))
assert Path(debris_scanner.__file__).is_relative_to(prefix), debris_scanner.__file__
share = Path(get_package_share_directory('debris_scanner'))
assert (share / 'launch' / 'scan.launch.py').is_file() and (share / 'params' / 'default.yaml').is_file()
print('found by ament in', prefix)
"""


def main() -> int:
    """Build the wheel and the package, and try it."""
    parser = argparse.ArgumentParser(prog='python -m tools.debian', description=__doc__)
    parser.add_argument('--out', type=Path, default=ROOT / 'dist', metavar='DIR', help='folder (dist)')
    parser.add_argument('--check', action='store_true', help='install it into a root of its own, and run it')
    args = parser.parse_args()
    if shutil.which('dpkg-deb') is None:
        print('tools.debian: no dpkg-deb: only on Debian and what comes of it', file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        package = build(dist.build(Path(folder))[1], args.out)
    print(package)
    if args.check:
        check(package)
    return 0


if __name__ == '__main__':
    sys.exit(main())
