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

"""A sensor whose lens distorts, rendered along its rays, is scanned as well as one without a lens."""

import dataclasses
import json

import pytest
from lens_rays import LensRays

from debris_scanner.cli.main import main
from debris_scanner.sensing.rectification import Distortion
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import Simulation, SimulationSettings, write_truth
from msg_adapters.bag_writer import BagWriter
from msg_adapters.depth_images import camera_info_message, depth_image_message

LENS = Distortion('plumb_bob', (-0.25, 0.08, 0.002, -0.001, 0.0))
WORSE = 1.1


def model_error(folder, lens):
    """RMSE, mm, of the model of a scan."""
    sensor = find_sensor('flexx')
    if lens is not None:
        sensor = dataclasses.replace(sensor, rays=LensRays(sensor.rays.camera, lens))
    # without noise: what so few frames tell of a sensor's own offset differs more than lenses do
    settings = SimulationSettings(
        'shuttle_stack', 'spin', sensor='flexx', rate_hz=6.0, seconds=7.5, spin_rad_s=1.0, noise=False
    )
    simulation = Simulation(settings, sensor=sensor)
    with BagWriter(folder / 'bag', compress=True) as bag:
        frames = list(simulation)
        for frame in frames:
            info = camera_info_message(frame.stamp_ns, 's', simulation.camera)
            if lens is not None:
                info.distortion_model, info.d = lens.model, list(lens.coefficients)
            depth = depth_image_message(frame.stamp_ns, 's', frame.depth, sensor.encoding)
            bag.write('/depth/camera_info', info)
            bag.write('/depth/image_raw', depth)
        stamps, poses = [f.stamp_ns for f in frames], [f.T_sensor_target for f in frames]
        write_truth(bag.folder, stamps, poses, simulation.target)
    assert main(['scan', str(folder / 'bag'), '--out', str(folder / 'out')]) == 0
    assert main(['evaluate', str(folder / 'out'), '--truth', str(folder / 'bag')]) == 0
    metrics = json.loads((folder / 'out' / 'metrics.json').read_text())
    assert metrics['verdict'] == 'right'
    return metrics['model_mm']['rmse']


@pytest.mark.slow
def test_a_lens_costs_no_accuracy(tmp_path):
    without, with_lens = (
        model_error(folder, lens)
        for folder, lens in ((tmp_path / 'pinhole', None), (tmp_path / 'lens', LENS))
        if folder.mkdir() is None
    )
    assert with_lens <= WORSE * without
