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

"""The input of a live scan: a bag, a simulation, a driver that is started, or one that is already running."""

import argparse
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from debris_scanner.cli.errors import CliError
from debris_scanner.cli.scan import input_options
from debris_scanner.cli.simulate import simulation_settings
from debris_scanner.nodes.inputs.cameras import CAMERAS

if TYPE_CHECKING:
    from debris_scanner.core.frames import DepthFrame
    from debris_scanner.sim.session import Simulation

# Long enough for one turn of the default spin, the model, and tracking.
SIMULATED_SECONDS = 45.0
TRUTH = 'truth'


@dataclass
class Source:
    """The node that publishes the input, if one has to be started, and its parameters."""

    node: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    simulation: 'Simulation | None' = None
    truth_dir: Path | None = None
    is_camera: bool = False  # it has no end, and may become silent
    camera: str | None = None  # whose driver runs already

    @property
    def has_colour(self) -> bool:
        """Whether a picture may come beside the depth."""
        if self.simulation is None:
            return True
        return self.simulation.settings.colour or self.simulation.settings.infrared

    def frames(self) -> 'Iterator[DepthFrame]':
        """The frames that the simulated camera sent."""
        from debris_scanner.sim.session import frames_again

        assert self.simulation is not None
        assert self.truth_dir is not None
        return frames_again(self.simulation, self.truth_dir)


def choose_source(args: argparse.Namespace) -> Source:
    """The source of the options, checked before any process is started.

    Raises:
        CliError: an impossible simulation, or a driver without its library.
        BagError: the bag is unusable.
    """
    if args.bag is not None:
        return _bag(args)
    if args.simulate is not None:
        return _simulation(args)
    if args.driver is not None:
        return _driver(args)
    if args.device is not None or any(':=' in given for given in args.camera):
        raise CliError('--device and --camera NAME:=VALUE need --driver')
    for camera in args.camera:
        if camera not in CAMERAS or len(args.camera) > 1:
            raise CliError(f'--camera {" ".join(args.camera)}: must be one of {", ".join(CAMERAS)}')
        return Source(camera=camera)
    return Source()


def _bag(args: argparse.Namespace) -> Source:
    from msg_adapters.bags import open_session

    with open_session(args.bag, args.topic, input_options(args)) as session:
        args.depth_scale = args.depth_scale or session.depth_unit
        parameters = {
            'bag': str(args.bag.resolve()),
            'topic': session.topic,
            'rate': args.speed,
            'loops': args.loops,
        }
    return Source('play_bag', parameters)


def _driver(args: argparse.Namespace) -> Source:
    import yaml

    from debris_scanner.drivers.faults import DriverError
    from debris_scanner.drivers.library_check import check_library

    parameters: dict[str, Any] = {}
    for given in args.camera:
        name, separator, value = given.partition(':=')
        if not separator or not name:
            raise CliError(f'--camera {given}: must be NAME:=VALUE')
        parameters[name] = yaml.safe_load(value)
        if name in ('fx', 'fy', 'cx', 'cy', 'max_rate_hz') and isinstance(parameters[name], int):
            parameters[name] = float(parameters[name])  # ROS rejects an integer for a float
    if args.device:
        path = Path(args.device)
        parameters['device'] = str(path.resolve()) if path.exists() else args.device
        if not path.exists() and (path.suffix == '.oni' or path.parent != Path()) and ':' not in args.device:
            raise CliError(f'{args.device} does not exist')
    try:
        check_library(args.driver, str(parameters.get('library', '')))
    except DriverError as error:
        raise CliError(str(error)) from None
    return Source(f'{args.driver}_camera', parameters, is_camera=True)


def _simulation(args: argparse.Namespace) -> Source:
    from debris_scanner.sim.session import Simulation

    settings = simulation_settings(args, args.simulate)
    if settings.seconds is None:
        settings = dataclasses.replace(settings, seconds=max(settings.duration_s, SIMULATED_SECONDS))
    try:
        simulation = Simulation(settings)
    except ValueError as error:
        raise CliError(str(error)) from error
    truth_dir = args.out / TRUTH
    given = {name: value for name, value in dataclasses.asdict(settings).items() if value is not None}
    parameters = {k: list(v) if isinstance(v, tuple) else v for k, v in given.items()}
    if (mesh := Path(settings.target)).is_file():
        parameters['target'] = str(mesh.resolve())
    parameters['truth_dir'] = str(truth_dir.resolve())
    return Source('sim_kinect', parameters, simulation, truth_dir)
