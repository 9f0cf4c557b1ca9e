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

"""Whether the libraries are there, told without loading them here."""

import pytest
from devices import need_library

from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.drivers.library_check import DRIVERS, check_library, load


@pytest.mark.parametrize('driver', DRIVERS)
def test_installed_library_says_its_name(driver):
    need_library(driver)
    assert check_library(driver)


@pytest.mark.parametrize('driver', DRIVERS)
def test_missing_library_says_what_to_install(driver):
    with pytest.raises(DriverError) as caught:
        check_library(driver, '/nowhere/library.so')
    assert caught.value.fault == Fault.LIBRARY
    assert 'install' in caught.value.advice


def test_another_library_is_not_taken_for_it():
    with pytest.raises(DriverError, match='cannot be loaded'):
        load('freenect', 'libc.so.6')


def test_library_that_crashes(tmp_path, monkeypatch):
    (tmp_path / 'openni').mkdir()
    (tmp_path / 'openni' / '__init__.py').write_text('import os; os.abort()')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    with pytest.raises(DriverError, match='crashes when it is loaded'):
        check_library('openni2')
