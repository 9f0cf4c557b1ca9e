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

"""``debris-scan import SOURCE --out BAG``: converts a recording of depth as people have it to a rosbag2."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from debris_scanner.cli.errors import DONE, CliError
from debris_scanner.cli.scan import add_input_arguments

if TYPE_CHECKING:
    from debris_scanner.core.frames import DepthFrame
    from debris_scanner.io.recordings.recording import Given, Recording
    from msg_adapters.bag_writer import BagWriter

FIRST_STAMP_NS = 1_000_000_000  # zero means "no time" to ROS
FRAME_ID = 'camera_depth_optical_frame'
BAGS = ('.bag', '.mcap', '.db3')
RATE = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Convert a recording to a rosbag2: a folder of depth images with intrinsics (ours, that of the '
        'recorder of Open3D, TUM RGB-D, BOP), a sequence of PCD or PLY clouds or an npz of grids, a .bag of '
        'a RealSense, an .mkv of an Azure Kinect. docs/import.md has a table of them. Colour of the same '
        'pixels comes along, masks beside the depth choose the target. Where there are poses, truth.tum and '
        'truth_cloud.ply are written into the folder of the bag.'
    )
    parser.add_argument('source', type=Path, metavar='SOURCE', help='folder or file of the recording')
    parser.add_argument('--out', type=Path, required=True, metavar='BAG', help='folder of the new bag')
    parser.add_argument(
        '--rate',
        type=_rate,
        metavar='HZ',
        help=f'frames per second, where the frames have no time ({RATE:g})',
    )
    add_input_arguments(parser)
    parser.add_argument(
        '--intrinsics', type=_intrinsics, metavar='FX,FY,CX,CY', help='of the depth images, pixels'
    )
    parser.add_argument(
        '--target', default='', metavar='ID', help='of a BOP scene: the object that is scanned'
    )
    parser.add_argument(
        '--colour', action='store_true', help='write coloured clouds (points) instead of depth images'
    )


def run(args: argparse.Namespace) -> int:
    """Write the bag and, if there are poses, its truth."""
    from debris_scanner.io.recordings.layouts import open_recording
    from msg_adapters.bag_writer import BagWriter

    if args.source.suffix.lower() in BAGS or (args.source / 'metadata.yaml').is_file():
        return _convert(args)
    source = open_recording(args.source, _given(args))
    stamps = _stamps(source, args.rate)
    with BagWriter(args.out, compress=True) as bag:
        _write_frames(bag, source, stamps, args.colour)
        if any(pose is not None for pose in source.poses):
            _write_truth(bag.folder, source, stamps)
    for remark in source.remarks:
        print(f'{args.source}: {remark}')
    truth = ' with truth.tum and truth_cloud.ply' if source.poses else ', without poses: no truth'
    span = (stamps[-1] - stamps[0]) / 1e9
    print(f'{args.out}: {source.count} frames of {source.layout} over {span:.1f} s{truth}')
    return DONE


def _given(args: argparse.Namespace) -> 'Given':
    from debris_scanner.io.recordings.recording import Given
    from debris_scanner.sensing.cloud_axes import parse_axes

    axes = parse_axes(args.axes) if args.axes else None
    return Given(args.depth_scale, args.intrinsics, axes, args.target)


def _stamps(source: 'Recording', rate: float | None) -> list[int]:
    """A stamp for each frame: its own where it has one, which a rate would contradict."""
    if not source.stamps_ns or rate is not None:
        return [FIRST_STAMP_NS + round(k * 1e9 / (rate or RATE)) for k in range(source.count)]
    shift = max(0, FIRST_STAMP_NS - source.stamps_ns[0])
    return [stamp + shift for stamp in source.stamps_ns]


def _convert(args: argparse.Namespace) -> int:
    """A bag of another recorder as one of ours: the frames that a scan of it sees."""
    from msg_adapters.bag_writer import BagWriter
    from msg_adapters.bags import open_session
    from msg_adapters.errors import MalformedMessage
    from msg_adapters.inputs.decoder import InputOptions

    with open_session(args.source, options=InputOptions(args.depth_scale, args.axes)) as session:
        stamps: list[int] = []
        refused: list[str] = []
        with BagWriter(args.out, compress=True) as bag:
            for stamp_ns, frame in session:
                if isinstance(frame, MalformedMessage) or (stamps and stamp_ns <= stamps[-1]):
                    refused.append(str(frame) if isinstance(frame, MalformedMessage) else 'its stamp repeats')
                    continue
                _write_depth(bag, frame, 0.0)
                stamps.append(stamp_ns)
            if not stamps:
                raise CliError(f'{args.source} has no frame that can be read: {(refused or ["none"])[0]}')
        for warning in session.warnings:
            print(f'{args.source}: {warning}')
        left_out = f', {len(refused)} left out: {refused[0]}' if refused else ''
        print(f'{args.out}: {len(stamps)} frames of {session.topic}{left_out}')
    return DONE


def _write_frames(bag: 'BagWriter', source: 'Recording', stamps: list[int], colour: bool) -> None:
    from tqdm import tqdm

    from msg_adapters.clouds import cloud_message
    from msg_adapters.depth_images import cloud_frame_message

    if colour and not source.has_colour:
        raise CliError('--colour was given, but the folder has no colour images')
    for k, stamp in enumerate(tqdm(stamps, desc='import', unit='frame', disable=None)):
        if source.cloud is not None:
            points, rgb = source.cloud(k)
            fields = {axis: points[..., i] for i, axis in enumerate('xyz')}
            bag.write('/points', cloud_message(stamp, FRAME_ID, fields, rgb))
        elif colour:
            bag.write('/points', cloud_frame_message(source.read(k, stamp), FRAME_ID))
        else:
            _write_depth(bag, source.read(k, stamp), source.unit)


def _write_depth(bag: 'BagWriter', frame: 'DepthFrame', unit: float) -> None:
    """A depth image with camera_info and colour; in millimetres where the recording's unit is one."""
    from debris_scanner.io.recordings.recording import MILLIMETRE
    from msg_adapters.colour_images import colour_image_message
    from msg_adapters.depth_images import camera_info_message, depth_image_message

    stamp = frame.stamp_ns
    bag.write('/depth/camera_info', camera_info_message(stamp, FRAME_ID, frame.camera))
    encoding: Literal['16UC1', '32FC1'] = '16UC1' if unit == MILLIMETRE else '32FC1'
    bag.write('/depth/image_raw', depth_image_message(stamp, FRAME_ID, frame.depth, encoding))
    if frame.rgb is not None:
        bag.write('/rgb/image_raw', colour_image_message(stamp, FRAME_ID, frame.rgb))


def _write_truth(folder: Path, source: 'Recording', stamps: list[int]) -> None:
    import numpy as np

    from debris_scanner.core.geometry import apply, inverse
    from debris_scanner.core.results import StampedPose
    from debris_scanner.evaluation.truth_cloud import cloud_ply, fuse_depth
    from debris_scanner.io.files import write_atomically
    from debris_scanner.io.trajectories import write_tum

    posed = [
        (k, stamp, T) for k, (stamp, T) in enumerate(zip(stamps, source.poses, strict=True)) if T is not None
    ]
    if source.cloud is not None:  # points that were measured are taken as they are
        clouds = [apply(T, source.cloud(k)[0].reshape(-1, 3)) for k, _, T in posed]
        points = np.concatenate([p[np.isfinite(p).all(axis=1)] for p in clouds]).astype(np.float32)
    else:
        points = fuse_depth((source.read(k, stamp), T) for k, stamp, T in posed)
    write_atomically(folder / 'truth_cloud.ply', cloud_ply(points))
    write_tum(folder / 'truth.tum', [StampedPose(stamp, inverse(T)) for _, stamp, T in posed])


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0 < rate <= 1e6:
        raise argparse.ArgumentTypeError(f'{text} is not a rate between 0 and 1e6 Hz')
    return rate


def _intrinsics(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split(','))
    except ValueError:
        values = ()
    if len(values) != 4 or not all(math.isfinite(v) for v in values) or min(values[:2]) <= 0:
        raise argparse.ArgumentTypeError(f'{text} is not FX,FY,CX,CY in pixels')
    return values
