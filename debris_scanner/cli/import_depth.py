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

"""``debris-scan import DEPTH_DIR --out BAG``: converts a folder of depth images to a rosbag2."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from debris_scanner.cli.errors import DONE, CliError
from debris_scanner.io.depth_folder import DepthFolder, open_depth_folder

if TYPE_CHECKING:
    from msg_adapters.bag_writer import BagWriter

FIRST_STAMP_NS = 1_000_000_000  # zero means "no time" to ROS
FRAME_ID = 'camera_depth_optical_frame'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Convert a folder of depth images (16-bit png, millimetres) with its Intrinsic.txt to a rosbag2. '
        'The images are in DEPTH_DIR or in DEPTH_DIR/depth and are ordered by their numbers. If '
        'DEPTH_DIR/poses has a 4x4 camera-to-target transform for each, truth.tum and truth_cloud.ply '
        'are written into the folder of the bag.'
    )
    parser.add_argument('folder', type=Path, metavar='DEPTH_DIR', help='folder of depth images')
    parser.add_argument('--out', type=Path, required=True, metavar='BAG', help='folder of the new bag')
    parser.add_argument(
        '--rate', type=_rate, default=5.0, metavar='HZ', help='frames per second, as images have no time (5)'
    )
    parser.add_argument(
        '--colour', action='store_true', help='write coloured clouds (points) instead of depth images'
    )


def run(args: argparse.Namespace) -> int:
    """Write the bag and, if there are poses, its truth."""
    from msg_adapters.bag_writer import BagWriter

    source = open_depth_folder(args.folder)
    stamps = [FIRST_STAMP_NS + round(k * 1e9 / args.rate) for k in range(len(source))]
    with BagWriter(args.out, compress=True) as bag:
        _write_frames(bag, source, stamps, args.colour)
        if source.poses:
            _write_truth(bag.folder, source, stamps)
    truth = ' with truth.tum and truth_cloud.ply' if source.poses else ', without poses: no truth'
    print(f'{args.out}: {len(source)} frames over {(stamps[-1] - stamps[0]) / 1e9:.1f} s{truth}')
    return DONE


def _write_frames(bag: 'BagWriter', source: DepthFolder, stamps: list[int], colour: bool) -> None:
    from tqdm import tqdm

    from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message

    if colour and not source.colour:
        raise CliError('--colour was given, but the folder has no colour images')
    for k, stamp in enumerate(tqdm(stamps, desc='import', unit='frame', disable=None)):
        frame = source.frame(k, stamp)
        if colour:
            bag.write('/points', cloud_frame_message(frame, FRAME_ID))
            continue
        bag.write('/depth/camera_info', camera_info_message(stamp, FRAME_ID, frame.camera))
        bag.write('/depth/image_raw', depth_image_message(stamp, FRAME_ID, frame.depth, '16UC1'))


def _write_truth(folder: Path, source: DepthFolder, stamps: list[int]) -> None:
    from debris_scanner.core.geometry import inverse
    from debris_scanner.core.results import StampedPose
    from debris_scanner.evaluation.truth_cloud import cloud_ply, fuse_depth
    from debris_scanner.io.files import write_atomically
    from debris_scanner.io.trajectories import write_tum

    frames = ((source.frame(k, stamp), source.poses[k]) for k, stamp in enumerate(stamps))
    write_atomically(folder / 'truth_cloud.ply', cloud_ply(fuse_depth(frames)))
    poses = zip(stamps, source.poses, strict=True)
    write_tum(folder / 'truth.tum', [StampedPose(stamp, inverse(T)) for stamp, T in poses])


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0 < rate <= 1e6:
        raise argparse.ArgumentTypeError(f'{text} is not a rate between 0 and 1e6 Hz')
    return rate
