"""What a live scan listens to: a bag that is played, a simulation, or whatever driver runs already."""

import argparse
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from debris_scanner.cli.errors import CliError
from debris_scanner.cli.simulate import simulation_settings

if TYPE_CHECKING:
    from debris_scanner.frames import DepthFrame
    from debris_scanner.sim.session import Simulation

# Long enough for the default spin to come round, be modelled and be tracked.
SIMULATED_SECONDS = 45.0
TRUTH = 'truth'


@dataclass
class Source:
    """The node to start, if any, and its parameters."""

    node: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    simulation: 'Simulation | None' = None
    truth_dir: Path | None = None

    def frames(self) -> 'Iterator[DepthFrame]':
        """The frames that the simulated camera sent, made again, with the stamps that they had."""
        import numpy as np

        from debris_scanner.frames import DepthFrame
        from debris_scanner.sim.session import TRUTH_POSES
        from debris_scanner.trajectory_files import read_tum

        assert self.simulation is not None
        assert self.truth_dir is not None
        for k, pose in enumerate(read_tum(self.truth_dir / TRUTH_POSES)):
            frame = self.simulation.frame(k)
            yield DepthFrame(pose.stamp_ns, frame.depth_mm * np.float32(0.001), frame.camera)


def choose_source(args: argparse.Namespace) -> Source:
    """The source that the options ask for, checked before anything is started.

    Raises:
        CliError: a simulation that cannot be.
        BagError: no usable bag.
    """
    if args.bag is not None:
        return _bag(args)
    if args.simulate is not None:
        return _simulation(args)
    return Source()


def _bag(args: argparse.Namespace) -> Source:
    from msg_adapters.bags import open_session

    with open_session(args.bag, args.topic) as session:
        parameters = {
            'bag': str(args.bag.resolve()),
            'topic': session.topic,
            'rate': args.speed,
            'loops': args.loops,
        }
    return Source('play_bag', parameters)


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
