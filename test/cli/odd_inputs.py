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

"""Kinds of input that no scan can use, each a bag, a file or an argument that is odd in one thing."""

import io
import itertools
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image as Picture
from sensor_msgs.msg import CompressedImage

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.bag_writer import BagWriter
from msg_adapters.clouds import byte_array
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message
from msg_adapters.stamps import header_message

CAMERA = Camera(66.0, 66.0, 39.5, 29.5, 80, 60)
FRAMES, PERIOD_NS, FIRST_NS = 4, 100_000_000, 1_700_000_000_000_000_000
DEPTH, INFO, POINTS = '/camera/depth/image_raw', '/camera/depth/camera_info', '/camera/points'
COMPRESSED = f'{DEPTH}/compressedDepth'
NAN, INF = float('nan'), float('inf')

Messages = list[tuple[str, Any, int]]  # topic, message, the time that it was recorded


class Odd(NamedTuple):
    """A kind of odd input: what is odd, and what makes the arguments of ``debris-scan scan`` in a folder."""

    name: str
    arguments: Callable[[Path], list[str]]


def ball(k: int = 0) -> np.ndarray:
    """Depth (60, 80), m, of a ball before nothing; it wanders, so that no two frames are alike."""
    x, y = np.meshgrid(np.arange(80) - 40 - 2 * k, np.arange(60) - 30)
    bulge = 400.0 - x**2 - y**2
    return np.where(bulge > 0, 0.8 - 0.01 * np.sqrt(np.maximum(bulge, 0)), 0).astype(np.float32)


def images(encoding: str = '16UC1') -> Messages:
    """Depth images with their camera_info."""
    made: Messages = []
    for k in range(FRAMES):
        stamp = FIRST_NS + k * PERIOD_NS
        made.append((INFO, camera_info_message(stamp, 'optical', CAMERA), stamp))
        made.append((DEPTH, depth_image_message(stamp, 'optical', ball(k), encoding), stamp))
    return made


def clouds() -> Messages:
    """Organised clouds."""
    stamps = [FIRST_NS + k * PERIOD_NS for k in range(FRAMES)]
    frames = [DepthFrame(stamp, ball(k), CAMERA) for k, stamp in enumerate(stamps)]
    return [(POINTS, cloud_frame_message(f, 'optical'), f.stamp_ns) for f in frames]


def bag(
    make: Callable[[], Messages], change: Callable[[Any], None], topic: str
) -> Callable[[Path], list[str]]:
    """Arguments for a bag in which each message of a topic is changed."""

    def arguments(folder: Path) -> list[str]:
        with BagWriter(folder / 'bag') as writer:
            for name, message, time_ns in make():
                if name == topic:
                    change(message)
                writer.write(name, message, time_ns)
        return [str(folder / 'bag')]

    return arguments


def setting(**values: Any) -> Callable[[Any], None]:
    """Sets fields of a message."""

    def change(message: Any) -> None:
        for name, value in values.items():
            setattr(message, name, value)

    return change


def entry(field: str, *places: int, value: float) -> Callable[[Any], None]:
    """Sets entries of an array of a message."""

    def change(message: Any) -> None:
        array = np.array(getattr(message, field), np.float64)
        array[list(places)] = value
        setattr(message, field, array)

    return change


def pixels(dtype: str, values: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any], None]:
    """Replaces what an image shows, by its depth in metres."""

    def change(image: Any) -> None:
        unit = 1e-3 if dtype == '<u2' else 1.0
        depth = np.frombuffer(bytes(image.data), dtype).reshape(image.height, -1) * unit
        with np.errstate(all='ignore'):
            image.data = byte_array(np.asarray(values(depth)).astype(dtype).tobytes())

    return change


def camera_infos() -> Iterator[Odd]:
    """What a camera_info may say."""
    bad = (0.0, -525.0, NAN, INF, -INF, 1e-9, 1e12)
    for (name, place), value in itertools.product((('fx', 0), ('fy', 4)), bad):
        yield Odd(f'{name} {value}', bag(images, entry('k', place, value=value), INFO))
    for (name, place), value in itertools.product((('cx', 2), ('cy', 5)), (NAN, INF, -1e9, 1e9)):
        yield Odd(f'{name} {value}', bag(images, entry('k', place, value=value), INFO))
    yield Odd('K zeros', bag(images, setting(k=np.zeros(9), p=np.zeros(12)), INFO))
    yield Odd('K nan', bag(images, setting(k=np.full(9, NAN)), INFO))
    for width, height in ((0, 0), (0, 60), (80, 0), (1, 1), (60, 80), (40, 30), (160, 120), (2**31, 2**31)):
        yield Odd(
            f'camera_info of {width} x {height}', bag(images, setting(width=width, height=height), INFO)
        )
    for model, count, value in (
        ('plumb_bob', 5, NAN), ('plumb_bob', 5, 1e6), ('plumb_bob', 5, -INF), ('plumb_bob', 3, 0.5),
        ('rational_polynomial', 8, NAN), ('rational_polynomial', 8, -50.0), ('rational_polynomial', 2, 0.1),
        ('equidistant', 4, INF), ('equidistant', 4, 1e9), ('equidistant', 1, 0.1), ('thin_prism', 4, 0.1),
        ('fisheye_of_mine', 5, 0.1), ('', 5, 0.1),
    ):  # fmt: skip
        change = setting(distortion_model=model, d=[value] * count)
        yield Odd(f'lens {model} {count} x {value}', bag(images, change, INFO))


def depth_images() -> Iterator[Odd]:
    """What an image may be."""
    for encoding in (
        '', 'rgb8', 'bgra8', 'mono8', '8UC1', '8SC1', '16SC1', '32SC1', '64FC1', '16UC3', '32FC2', '16UC99',
        'bayer_rggb8', 'yuv422', 'depth', '16uc1 ', 'Ω',
    ):  # fmt: skip
        yield Odd(f'encoding {encoding!r}', bag(images, setting(encoding=encoding), DEPTH))
    for step in (0, 1, 79, 159, 161, 2**31):
        yield Odd(f'step {step}', bag(images, setting(step=step), DEPTH))
    for width, height in ((0, 0), (0, 60), (80, 0), (1, 1), (81, 60), (80, 61), (2**31, 2**31), (60, 80)):
        yield Odd(f'image of {width} x {height}', bag(images, setting(width=width, height=height), DEPTH))
    for share in (0.0, 0.001, 0.5, 0.999):

        def cut(image: Any, share: float = share) -> None:
            image.data = byte_array(bytes(image.data)[: int(share * len(image.data))])

        yield Odd(f'{share} of the bytes', bag(images, cut, DEPTH))
    yield Odd('other byte order', bag(images, setting(is_bigendian=1), DEPTH))
    rng = np.random.default_rng(0)
    for name, values in {
        'zero': lambda d: 0 * d, 'NaN': lambda d: d * NAN, 'Inf': lambda d: d * INF,
        'negative': lambda d: -d - 1,
        'a plane': lambda d: 0 * d + 1, 'noise': lambda d: rng.uniform(0.1, 10, d.shape),
        'speckles': lambda d: np.where(rng.random(d.shape) < 0.01, 1, 0), 'huge': lambda d: d * 1e30,
        'tiny': lambda d: d * 1e-30, 'millimetres': lambda d: d * 1000,
        'half NaN': lambda d: np.where(rng.random(d.shape) < 0.5, d, NAN),
        'stripes': lambda d: d * (np.arange(80) % 2),
        'a single pixel': lambda d: np.where(np.arange(d.size).reshape(d.shape) == 2440, 1, 0),
        'one column': lambda d: np.where(np.arange(80) == 40, 1, 0) + 0 * d,
    }.items():  # fmt: skip
        yield Odd(f'depths: {name}', bag(lambda: images('32FC1'), pixels('<f4', values), DEPTH))
    for name, values in {
        'all 65535': lambda d: 0 * d + 65535, 'all 1': lambda d: 0 * d + 1, 'metres': lambda d: np.round(d),
        'rotated bits': lambda d: np.where(d > 0, 30000, 0),
    }.items():  # fmt: skip
        yield Odd(f'millimetres: {name}', bag(images, pixels('<u2', values), DEPTH))


def cloud_layouts() -> Iterator[Odd]:
    """What a cloud may be."""

    def field(axis: str, **values: Any) -> Callable[[Any], None]:
        def change(cloud: Any) -> None:
            for f in cloud.fields:
                if f.name == axis:
                    setting(**values)(f)

        return change

    for axis in 'xyz':
        yield Odd(f'no {axis}', bag(clouds, field(axis, name='w'), POINTS))
        yield Odd(f'{axis} upper case', bag(clouds, field(axis, name=axis.upper()), POINTS))
        for kind in (0, 1, 2, 3, 4, 5, 6, 9, 255):
            yield Odd(f'{axis} of type {kind}', bag(clouds, field(axis, datatype=kind), POINTS))
        for offset in (1, 13, 1000, 2**32 - 1):
            yield Odd(f'{axis} at {offset}', bag(clouds, field(axis, offset=offset), POINTS))
        for count in (0, 2, 10**6):
            yield Odd(f'{count} {axis}', bag(clouds, field(axis, count=count), POINTS))
    yield Odd('no fields', bag(clouds, setting(fields=[]), POINTS))
    for step in (0, 1, 11, 2**31):
        yield Odd(f'point_step {step}', bag(clouds, setting(point_step=step), POINTS))
    for width, height in ((0, 0), (80, 0), (1, 1), (80, 61), (2**31, 2), (4800, 1)):
        yield Odd(f'cloud of {width} x {height}', bag(clouds, setting(width=width, height=height), POINTS))
    for value in (NAN, INF, 0.0, 1e30, -1.0):

        def filled(cloud: Any, value: float = value) -> None:
            count = len(cloud.data) // 4
            cloud.data = byte_array(np.full(count, value, np.float32).tobytes())

        yield Odd(f'all coordinates {value}', bag(clouds, filled, POINTS))
    yield Odd('cloud without bytes', bag(clouds, setting(data=byte_array(b'')), POINTS))
    yield Odd('cloud in another byte order', bag(clouds, setting(is_bigendian=True), POINTS))

    def turned(cloud: Any) -> None:
        names = {'x': 'y', 'y': 'z', 'z': 'x'}
        for f in cloud.fields:
            f.name = names.get(f.name, f.name)
        cloud.height, cloud.width = 1, cloud.width * cloud.height
        cloud.header.frame_id = 'rig'

    yield Odd('cloud in no optical frame', bag(clouds, turned, POINTS))


def compressed() -> Iterator[Odd]:
    """What a compressed depth image may be."""

    def png(values: np.ndarray) -> bytes:
        file = io.BytesIO()
        Picture.fromarray(values).save(file, 'PNG')
        return file.getvalue()

    head, good = struct.pack('<iff', 0, 0.0, 0.0), png((1000 * ball()).astype(np.uint16))
    usual = '16UC1; compressedDepth png'
    for name, format_, data in (
        ('jpeg', '16UC1; jpeg compressed', head + good), ('no format', '', head + good),
        ('rvl of nothing', '16UC1; compressedDepth rvl', head + b'\0' * 8), ('of colour', 'rgb8; png', good),
        ('empty', usual, b''), ('head alone', usual, head), ('cut', usual, head + good[: len(good) // 2]),
        ('noise', usual, head + bytes(range(256)) * 8),
        ('8 bits', usual, head + png(np.zeros((60, 80), np.uint8))),
        ('colour', usual, head + png(np.zeros((60, 80, 3), np.uint8))),
        ('without quantisation', '32FC1; compressedDepth png', head + good),
        ('of another size', usual, head + png(np.ones((6, 8), np.uint16))),
        ('of all zeros', usual, head + png(np.zeros((60, 80), np.uint16))),
        ('NaN quantised', '32FC1; compressedDepth png', struct.pack('<iff', 0, NAN, NAN) + good),
    ):  # fmt: skip

        def messages(format_: str = format_, data: bytes = data) -> Messages:
            made: Messages = []
            for k in range(FRAMES):
                stamp = FIRST_NS + k * PERIOD_NS
                image = CompressedImage(header=header_message(stamp, 'optical'), format=format_)
                image.data = byte_array(data)
                made.append((INFO, camera_info_message(stamp, 'optical', CAMERA), stamp))
                made.append((COMPRESSED, image, stamp))
            return made

        yield Odd(f'compressed: {name}', bag(messages, setting(), ''))


def times() -> Iterator[Odd]:
    """What the stamps may be, by the time of the k-th frame."""
    for name, stamp in {
        'zero': lambda k: 0, 'all alike': lambda k: FIRST_NS, 'falling': lambda k: FIRST_NS - k * PERIOD_NS,
        'the last possible': lambda k: (2**31 - 1) * 10**9 + k, 'a nanosecond apart': lambda k: FIRST_NS + k,
        'a year apart': lambda k: FIRST_NS + k * 31_536_000 * 10**9, 'from 1970 on': lambda k: k * 5 * 10**17,
    }.items():  # fmt: skip

        def messages(stamp: Callable[[int], int] = stamp) -> Messages:
            made = images()
            for n, (_, message, _) in enumerate(made):
                message.header = header_message(stamp(n // 2), 'optical')
            return made

        yield Odd(f'stamps: {name}', bag(messages, setting(), ''))
        yield Odd(
            f'recorded: {name}',
            bag(
                lambda stamp=stamp: [(t, m, stamp(n // 2)) for n, (t, m, _) in enumerate(images())],
                setting(),
                '',
            ),
        )


def bags() -> Iterator[Odd]:
    """What a bag may lack."""
    yield Odd('no camera_info', bag(lambda: [m for m in images() if m[0] == DEPTH], setting(), ''))
    yield Odd('no image', bag(lambda: [m for m in images() if m[0] == INFO], setting(), ''))
    yield Odd('no message', bag(list, setting(), ''))
    yield Odd('one frame', bag(lambda: images()[:2], setting(), ''))
    yield Odd('camera_info of another camera', bag(
        lambda: [(t.replace('/camera/', '/other/') if t == INFO else t, m, s) for t, m, s in images()],
        setting(), '',
    ))  # fmt: skip


def usable(*more: str) -> Callable[[Path], list[str]]:
    """Arguments with a good bag and something else."""
    return lambda folder: [*bag(images, setting(), '')(folder), *more]


def files() -> Iterator[Odd]:
    """What may stand in place of a recording."""
    contents = {
        'empty': b'',
        'text': b'a recording\n',
        'zeros': bytes(4096),
        'a mcap cut': b'\x89MCAP0\r\n\x01',
    }
    for (name, content), suffix in itertools.product(contents.items(), ('.bag', '.db3', '.mcap', '.mkv', '')):

        def arguments(folder: Path, content: bytes = content, suffix: str = suffix) -> list[str]:
            (folder / f'odd{suffix}').write_bytes(content)
            return [str(folder / f'odd{suffix}')]

        yield Odd(f'{name} as {suffix or "no suffix"}', arguments)
    yield Odd('nothing there', lambda folder: [str(folder / 'nothing')])
    yield Odd('an empty folder', lambda folder: [str(folder)])
    yield Odd('a device', lambda folder: ['/dev/null'])
    for text in (
        '',
        'rosbag2_bagfile_information:\n',
        '{',
        'a: [1',
        '\0',
        'rosbag2_bagfile_information: 7\n',
    ):

        def described(folder: Path, text: str = text) -> list[str]:
            (folder / 'metadata.yaml').write_text(text)
            return [str(folder)]

        yield Odd(f'metadata {text!r}', described)


def options() -> Iterator[Odd]:
    """What may be given beside a good recording."""
    for given in (
        ('--topic', '/nothing'), ('--topic', INFO), ('--topic', ''), ('--axes', 'x'), ('--axes', 'x,x,y'),
        ('--axes', 'up,down,left'), ('--axes', 'x,y,-z'), ('--depth-scale', '0'), ('--depth-scale', '-1'),
        ('--depth-scale', 'nan'), ('--depth-scale', 'many'), ('--depth-scale', '1e9'),
        ('--params', '/nothing'),
        ('--params', '/dev/null'), ('--model', '/nothing'), ('--model', '/dev/null'), ('--view', 'x'),
        ('--nothing',),
    ):  # fmt: skip
        yield Odd(' '.join(given), usable(*given))
    for name, content in {
        'model.ply': b'ply\n', 'model.stl': b'solid\n', 'model.obj': b'v 0 0 0\n', 'model.txt': b'no mesh',
        'empty.ply': b'', 'flat.obj': b'v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n',
        'nan.obj': b'v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n', 'index.obj': b'v 0 0 0\nf 1 2 3\n',
        'params.yaml': b'a: [', 'unknown.yaml': b'nothing:\n  ros__parameters:\n    none: 1\n',
        'list.yaml': b'- 1\n',
    }.items():  # fmt: skip

        def arguments(folder: Path, name: str = name, content: bytes = content) -> list[str]:
            (folder / name).write_bytes(content)
            option = '--params' if name.endswith('.yaml') else '--model'
            return [*bag(images, setting(), '')(folder), option, str(folder / name)]

        yield Odd(f'{name} {content[:12]!r}', arguments)


KINDS = [
    *camera_infos(), *depth_images(), *cloud_layouts(), *compressed(), *times(), *bags(), *files(),
    *options(),
]  # fmt: skip
