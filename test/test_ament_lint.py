"""The linters of a ROS 2 workspace, where they are installed: ``colcon test`` runs them there.

ament_copyright is not among them: it wants the licence's text atop every file, which here stands once, in
LICENSE.
"""

import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYTHON = [str(ROOT / name) for name in ('debris_scanner', 'msg_adapters', 'launch', 'setup.py')]
# tests, nodes and constructors speak by their names, as in pyproject.toml
UNSAID = ('D100', 'D101', 'D102', 'D103', 'D104', 'D105', 'D107')
TAKEN_FOR = ('D402', 'D403')  # formulas for signatures, CameraInfo for a slip


def test_flake8():
    linter = pytest.importorskip('ament_flake8.main')
    count, problems = linter.main_with_errors(argv=['--config', str(ROOT / 'setup.cfg'), *PYTHON])
    assert count == 0, '\n'.join(problems)


def test_pep257():
    linter = pytest.importorskip('ament_pep257.main')
    assert (
        linter.main(argv=['--convention', 'google', '--add-ignore', *UNSAID, *TAKEN_FOR, '--', *PYTHON]) == 0
    )


def test_xmllint():
    linter = pytest.importorskip('ament_xmllint.main')
    if shutil.which('xmllint') is None:
        pytest.skip('no xmllint: apt-get install libxml2-utils')
    assert linter.main(argv=[str(ROOT / 'package.xml'), str(ROOT / 'debris_scanner' / 'nodes')]) == 0
