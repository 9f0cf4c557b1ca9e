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

"""The scanner's own figures, by the functions that the stages are made of."""

import itertools
from collections.abc import Callable

import numpy as np

from benchmarks.performance.measure import Cost, PairError, Row, cpu_ms, repeat
from benchmarks.performance.scene import Shot, drifted, pair_error, pose_errors
from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.mapping.closures import verify
from debris_scanner.mapping.descriptors import efpfh
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.mapping.relaxation import Edge, relax
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse, refine_pose
from debris_scanner.registration.projective import register
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.stages import make_preprocessor
from debris_scanner.tracking.motion_filter import MotionFilter
from msg_adapters.depth_images import (
    camera_info_message,
    cloud_frame_message,
    depth_image_message,
)
from msg_adapters.inputs.decoder import FrameDecoder
from msg_adapters.target_frames import read_target_frame, target_frame_message

OURS = 'ours'
SETTINGS = Settings()


def frame_stages(shot: Shot, times: int) -> list[Row]:
    """From message to view: what every frame goes through before it is registered."""
    image = depth_image_message(1, 'camera', shot.depth.depth, '16UC1')
    info = camera_info_message(1, 'camera', shot.depth.camera)
    cloud = cloud_frame_message(shot.depth, 'camera')
    target = target_frame_message(shot.target, 'camera')

    def prepare() -> None:
        make_preprocessor(SETTINGS).process(shot.depth)

    tasks: list[tuple[str, Callable[[], object]]] = [
        ('decode depth image', lambda: FrameDecoder().image(image, info)),
        ('decode cloud', lambda: FrameDecoder().cloud(cloud)),
        ('isolate, normals', prepare),
        ('view', lambda: View(shot.target)),
        ('encode target', lambda: target_frame_message(shot.target, 'camera')),
        ('decode target', lambda: read_target_frame(target)),
        ('descriptor', lambda: efpfh(shot.view.points, shot.view.normals)),
        ('descriptor, 12 000 points', lambda: efpfh(shot.cloud, np.ones_like(shot.cloud) / np.sqrt(3))),
        ('filter', _filter_step),
    ]
    return [Row(name, OURS, repeat(task, times)) for name, task in tasks]


def _filter_step() -> None:
    """Prediction and three iterations of the update, without the registration in between."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), SETTINGS.motion, footprint=0.0015)
    motion.predict(0.1)
    prior = motion.copy()
    information = np.asarray(np.linalg.inv(prior.P + 1e-14 * np.eye(len(prior.P))), np.float64)
    H, g = np.eye(6) * 1e3, np.zeros(6)
    for _ in range(3):
        motion.update_step(prior, information, H, g)


def pairs(shots: list[Shot], what: str = 'pair') -> list[Row]:
    """Depth frame to registered pose, from the identity; each frame is prepared once, as in a scan."""
    milliseconds, errors = [], []
    preprocessor = make_preprocessor(SETTINGS)
    for k, (target, source) in enumerate(itertools.pairwise(shots)):
        found = None

        def scan(source: Shot = source, target: Shot = target) -> None:
            nonlocal found
            view = View(preprocessor.process(source.depth))
            found = register(view, np.eye(4), target.view, np.eye(4))

        assert target.view is not None  # prepared when it was the source
        if k == 0:
            scan()
            preprocessor.reset()  # the same stamp again
        milliseconds.append(cpu_ms(scan))
        assert found is not None
        errors.append(pair_error(found[0], target, source))
    return [Row(what, f'{OURS}: isolate, normals, projective', Cost.of(milliseconds), str(summary(errors)))]


def summary(errors: list[tuple[float, float]]) -> PairError:
    """Of (degrees, millimetres) a pair."""
    degrees, shifts = np.array(errors).T
    return PairError(float(degrees.mean()), float(degrees.max()), float(shifts.mean()))


def verification(shots: list[Shot], times: int) -> list[Row]:
    """A closure between neighbours, verified."""
    a, b = shots[0], shots[1]
    T_b = inverse(b.pose)

    def task() -> None:
        verify(b.view, T_b, a.view, inverse(a.pose), SETTINGS.verification)

    return [Row('verification', OURS, repeat(task, times))]


def relaxation(shots: list[Shot], edges: list[tuple[int, int]], name: str) -> Row:
    """Relaxation of all frames from their drifted poses."""
    views, start = [s.view for s in shots], drifted(shots)
    links = [Edge(i, j, is_closure=i != j + 1) for i, j in edges]
    result = None

    def task() -> None:
        nonlocal result
        result = relax(views, start, links, SETTINGS.pose_graph.iterations)

    cost = Cost.of([cpu_ms(task) for _ in range(3)])
    assert result is not None
    degrees, shift = pose_errors(result.poses, shots)
    return Row(name, OURS, cost, f'{degrees:.2f}°, {shift:.2f} mm')


def refinement(shots: list[Shot], times: int) -> list[Row]:
    """A stored frame against its key frames, and the fusion of all into a mesh."""
    keyframes = KeyFrameSet(SETTINGS.normals)
    for shot in shots[::2]:
        keyframes.add(KeyFrame(shot.target, inverse(shot.pose), 0.0), shot.view)
    centre = keyframes.centre
    shot = shots[1]
    posed = [(s.target, inverse(s.pose)) for s in shots]
    surface = None

    def mesh() -> None:
        nonlocal surface
        surface = fuse(posed, FusionSettings())

    cost = Cost.of([cpu_ms(mesh) for _ in range(3)])
    assert surface is not None
    one = repeat(lambda: refine_pose(shot.view, inverse(shot.pose), keyframes, centre)[0], times)
    return [
        Row('refine a frame', OURS, one),
        Row(
            'model and mesh',
            f'{OURS}: fusion of {len(shots)} frames',
            cost,
            f'{len(surface.triangles)} triangles',
        ),
    ]
