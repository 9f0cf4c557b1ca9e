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

"""Forecast and polhode of a page: drawn where they are known, absent elsewhere."""

import dataclasses
import shutil

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.rigid_body import propagate
from debris_scanner.report.forecast_plots import forecast_plot, polhode_plot
from debris_scanner.report.scan_output import ScanOutputError, read_scan

AXES = exp_so3(np.array([0.3, -0.8, 0.4]))  # principal axes in the target frame, columns
MOMENTS = np.array([0.5, 0.8, 1.0])


@pytest.fixture(scope='module')
def scan(session_result):
    return read_scan(session_result)


def test_the_tube_is_that_of_the_file_and_widens(scan):
    lines = forecast_plot(scan).figure.data
    upper = [line for line in lines if line.y[-1] > 0]
    assert len(lines) == 12
    assert len(upper) == 6
    assert list(upper[0].x) == pytest.approx(range(1, 61), abs=1e-6)
    np.testing.assert_allclose(upper[0].y, np.degrees(scan.forecast.attitude_sigma[:, 0]))
    assert all(line.y[-1] > line.y[0] for line in upper)
    assert forecast_plot(dataclasses.replace(scan, forecast=None)) is None


def test_a_spin_has_no_polhode_and_a_tumble_lies_on_its_ellipsoid(scan):
    assert polhode_plot(scan) is None
    told = {'observable': True, 'why': 'torque_free', 'inertia_ratios': MOMENTS[:2].tolist()}
    told['principal_axes'] = AXES.T.tolist()
    J, omega = AXES @ np.diag(MOMENTS) @ AXES.T, AXES @ np.array([0.1, 0.4, 0.15])
    _, rates = propagate(np.eye(3), omega, J, np.arange(1.0, 61.0))
    forecast = dataclasses.replace(scan.forecast, rates=rates)
    summary = {**scan.summary, 'mass_properties': told}
    ellipsoid, ahead, seen = polhode_plot(
        dataclasses.replace(scan, forecast=forecast, summary=summary)
    ).figure.data
    semi = np.array(
        [max(v for v in column if v is not None) for column in (ellipsoid.x, ellipsoid.y, ellipsoid.z)]
    )
    path = np.array([ahead.x, ahead.y, ahead.z])
    np.testing.assert_allclose(((path / semi[:, None]) ** 2).sum(axis=0), 1.0, atol=1e-3)
    assert len(seen.x) > 100


def test_a_damaged_forecast_is_named(session_result, tmp_path):
    folder = shutil.copytree(session_result, tmp_path / 'scan')
    lines = (folder / 'forecast.csv').read_text().splitlines()
    (folder / 'forecast.csv').write_text('\n'.join([*lines[:5], '1,2,3']))
    with pytest.raises(ScanOutputError, match='forecast'):
        read_scan(folder)
