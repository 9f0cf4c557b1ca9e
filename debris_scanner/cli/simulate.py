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

"""``debris-scan simulate TARGET --out BAG``: records a simulated session as a rosbag2, with its truth."""

import argparse
import math
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

from debris_scanner.cli.errors import DONE, CliError

if TYPE_CHECKING:
    from debris_scanner.sim.session import SensorSample, SimulationSettings
    from msg_adapters.bag_writer import BagWriter

FRAME_ID = 'camera_depth_optical_frame'
ODOMETRY_HZ = 50.0
TARGETS = (
    'shuttle_stack, tank_boosters, prism, cubesat, upper_stage, asteroid, defunct_satellite, cylinder, '
    'empty, or a mesh file (obj, stl, ply)'
)
MOTIONS = 'spin, decaying_spin, swing, clohessy_wiltshire, tumble, dzhanibekov, still, steps, stops, by_hand'
CLUTTER = 'wall, table, object, desk, or plate: a desk or a turntable that a spinning target stands on'
SENSORS = 'kinect1, kinect1_real, kinect2, d435, d405, azure, flexx, tof_space, lidar, d415_real'

_SIZE = "target's largest extent (its own, 0.25 to 0.4; d405 0.1, tof_space and lidar 4)"
_RANGE = (
    'distance of the target (kinect1 and d435 0.8, kinect2 1.2, d405 0.25, azure 1, flexx and d415_real 0.6, '
    'others 8)'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Record a simulated session: depth/image_raw and depth/camera_info of a depth camera, or points of a '
        'lidar, in front of a moving target, as a rosbag2 (mcap). truth.tum and truth_mesh.ply are written '
        'into its folder, never into messages. Equal options give equal images.'
    )
    parser.add_argument('target', metavar='TARGET', help=TARGETS)
    parser.add_argument('--out', type=Path, required=True, metavar='BAG', help='folder of the new bag')
    add_simulation_arguments(parser)
    parser.add_argument(
        '--sensor-odometry',
        action='store_true',
        help=f'record how the sensor moves, {ODOMETRY_HZ:.0f} times a second, as /sensor_odometry',
    )


def add_simulation_arguments(parser: argparse._ActionsContainer) -> None:
    """Options of the simulation, except the target."""
    _add_motion_arguments(parser)
    _add_sensor_arguments(parser)


def _add_motion_arguments(parser: argparse._ActionsContainer) -> None:
    """Of the target, its motion, and when it is seen."""
    add = parser.add_argument
    add('--motion', default='spin', metavar='M', help=f'{MOTIONS} (spin)')
    add('--seed', type=int, default=0, metavar='N', help='random seed of motion and noise (0)')
    add('--rate', type=_number, default=10.0, metavar='HZ', help='frames per second (10)')
    add('--seconds', type=_number, metavar='S', help='length (25; a tumble 60, by hand 45)')
    add('--size', type=_number, metavar='METRES', help=_SIZE)
    add('--spin', type=_number, default=0.5, metavar='RAD_S', help='rate; its sign is the direction (0.5)')
    add(
        '--axis',
        type=_number,
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help='spin axis in the sensor frame: x right, y down, z forward (near the vertical, by the seed)',
    )
    add('--spin-about', default='z', choices=('x', 'y', 'z'), help="the target's axis that spins (z)")
    add(
        '--inertia',
        type=_number,
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help="a tumble's principal moments about the target's axes, any unit (1 0.8 0.5)",
    )
    add(
        '--centre-of-mass',
        type=_number,
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help='point of the target frame that it turns about, metres (0 0 0)',
    )
    add('--damping', type=_number, metavar='S', help='time in which friction takes the rate to 1/e of it')
    add('--range', type=_number, metavar='METRES', help=_RANGE)
    add('--gaps', action='store_true', help='out of sight for 1 to 3 s now and then')
    add('--gaps-from', type=_number, default=0.0, metavar='S', help='earliest begin of a gap (0)')
    add('--patchy', action='store_true', help='partially occluded for 1 to 3 s now and then')
    add('--leaves', type=_number, metavar='S', help='time at which the target leaves for good')


def _add_sensor_arguments(parser: argparse._ActionsContainer) -> None:
    """Of the sensor, its noise, and what else it sees."""
    add = parser.add_argument
    add('--sensor', default='kinect1', metavar='S', help=f'{SENSORS} (kinect1)')
    add('--mli', action='store_true', help='shiny multi-layer insulation: holes and outliers')
    add(
        '--mli-share', type=_number, metavar='S', help='insulation on this share of the surface alone, 0 to 1'
    )
    add('--clutter', metavar='C', help=f'static background: {CLUTTER}')
    add('--correlated', action='store_true', help='noise correlated over 4 pixels, of kinect1')
    add('--no-noise', action='store_true', help='exact depths')
    add('--spatial-filter', action='store_true', default=None, help='smooth images up to their edges')
    add('--temporal-filter', action='store_true', default=None, help='average images over time')
    add('--pattern', type=_number, metavar='PX', help="RMS of a stereo camera's pattern fixed in the image")
    add('--junk', type=_number, metavar='S', help='share of the pixels that are said to be 10 to 12 m away')
    add('--doubled', action='store_true', default=None, help='each image comes twice')
    add('--hand', action='store_true', default=None, help='now and then a hand at the edge of the image')
    add('--focal-error', type=_number, metavar='S', help='of the focal lengths in camera_info, as a share')
    add('--colour', action='store_true', help='a painted target: rgb/image_raw, registered to the depth')
    add('--infrared', action='store_true', help="the sensor's own light: ir/image_raw; of a lidar intensity")
    add('--paint', default='stripes', metavar='P', help='stripes, markings (a rocket, black on white), plain')
    add('--light', metavar='L', help='of a lamp in the room on the colours: lamp, glossy (an even light)')


def simulation_settings(args: argparse.Namespace, target: str) -> 'SimulationSettings':
    """The settings from the options of :func:`add_simulation_arguments`."""
    from debris_scanner.sim.motions import INERTIA
    from debris_scanner.sim.session import SimulationSettings

    return SimulationSettings(
        target=target,
        motion=args.motion,
        seed=args.seed,
        rate_hz=args.rate,
        seconds=args.seconds,
        size=args.size,
        spin_rad_s=args.spin,
        axis_sensor=None if args.axis is None else (args.axis[0], args.axis[1], args.axis[2]),
        range_m=args.range,
        gaps=args.gaps,
        gaps_from_s=args.gaps_from,
        patchy=args.patchy,
        leaves_s=args.leaves,
        mli=args.mli or args.mli_share is not None,
        mli_share=1.0 if args.mli_share is None else args.mli_share,
        noise=not args.no_noise,
        correlated=args.correlated,
        clutter=args.clutter,
        colour=args.colour,
        infrared=args.infrared,
        paint=args.paint,
        light=args.light,
        sensor=args.sensor,
        spin_about=args.spin_about,
        inertia=INERTIA if args.inertia is None else tuple(args.inertia),
        centre_of_mass=(0.0, 0.0, 0.0) if args.centre_of_mass is None else tuple(args.centre_of_mass),
        damping_s=args.damping,
        spatial_filter=args.spatial_filter,
        temporal_filter=args.temporal_filter,
        bump_px=args.pattern,
        junk_share=args.junk,
        doubled=args.doubled,
        hand=args.hand,
        focal_error=args.focal_error,
    )


def run(args: argparse.Namespace) -> int:
    """Write the bag and its truth, completely or not at all."""
    from tqdm import tqdm

    from debris_scanner.sim.session import simulate, write_truth
    from msg_adapters.bag_writer import BagWriter
    from msg_adapters.clouds import xyz_message
    from msg_adapters.colour_images import colour_image_message
    from msg_adapters.depth_images import camera_info_message, depth_image_message

    try:
        simulation = simulate(simulation_settings(args, args.target))
    except ValueError as error:
        raise CliError(str(error)) from error
    stamps, poses = [], []
    odometry = deque(simulation.sensor_odometry(ODOMETRY_HZ) if args.sensor_odometry else [])
    with BagWriter(args.out, compress=True) as bag:
        for frame in tqdm(simulation, desc='simulate', unit='frame', disable=None):
            _write_odometry(bag, odometry, frame.stamp_ns)
            stamps.append(frame.stamp_ns)
            poses.append(frame.T_sensor_target)
            if frame.points is not None:
                cloud = xyz_message(frame.stamp_ns, FRAME_ID, frame.points, frame.infrared)
                bag.write('/points', cloud)
                continue
            bag.write('/depth/camera_info', camera_info_message(frame.stamp_ns, FRAME_ID, frame.camera))
            image = depth_image_message(frame.stamp_ns, FRAME_ID, frame.depth, simulation.model.encoding)
            bag.write('/depth/image_raw', image)
            if frame.picture is not None:
                topic = '/ir/image_raw' if frame.rgb is None else '/rgb/image_raw'
                bag.write(topic, colour_image_message(frame.stamp_ns, FRAME_ID, frame.picture))
        _write_odometry(bag, odometry, math.inf)
        write_truth(bag.folder, stamps, poses, simulation.target)
    print(
        f'{args.out}: {len(stamps)} frames over {(stamps[-1] - stamps[0]) / 1e9:.1f} s '
        'with truth.tum and truth_mesh.ply'
    )
    return DONE


def _write_odometry(bag: 'BagWriter', samples: 'deque[SensorSample]', until_ns: float) -> None:
    """Write the samples up to a stamp."""
    import numpy as np

    from msg_adapters.poses import odometry_message

    unknown = np.zeros((6, 6))  # twist
    while samples and samples[0].stamp_ns <= until_ns:
        s = samples.popleft()
        bag.write(
            '/sensor_odometry',
            odometry_message(
                s.stamp_ns, 'world', FRAME_ID, s.T_world_sensor, s.covariance, unknown[0], unknown
            ),
        )


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'{text} is not a number')
    return value
