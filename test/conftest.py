"""Fixtures that every test folder shares."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Folder of recorded data that is not part of this repository; skips the test where it is absent."""
    default = Path(__file__).resolve().parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('DEBRIS_SCANNER_DATA', default))
    if not folder.is_dir():
        pytest.skip(f'no recorded data at {folder}; set DEBRIS_SCANNER_DATA')
    return folder


@pytest.fixture(scope='session')
def golden() -> Path:
    """Folder of values computed by PCL 1.13 (cases.npz, refine.npz, ...); skips where it is absent."""
    default = Path(__file__).resolve().parents[2] / 'shared' / 'reference' / 'pcl-golden'
    folder = Path(os.environ.get('DEBRIS_SCANNER_GOLDEN', default))
    if not folder.is_dir():
        pytest.skip(f'no PCL values at {folder}; set DEBRIS_SCANNER_GOLDEN')
    return folder


@pytest.fixture(scope='session')
def session_bag() -> Path:
    """The recorded session of this repository: a spinning shuttle stack, two turns, with its truth."""
    return Path(__file__).resolve().parents[1] / 'bags' / 'shuttle_stack_spin'
