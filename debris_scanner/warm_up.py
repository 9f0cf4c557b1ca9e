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

"""Runs what is compiled or imported late, so that the first real frame is not delayed.

The kernels are compiled once per machine, by one process, and cached on disk (``kernel_cache.py``).
Loading them still takes time, which a live node has to spend before it subscribes, and memory: each stage
loads its own alone. SciPy loads each of its parts when it is first named.
"""

import importlib
import inspect
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, KeyFrame, Model, TargetFrame
from debris_scanner.kernel_cache import PACKAGE, WITHOUT_COLOUR, cache_folder, compile_once
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector, make_odometry, make_preprocessor

_CAMERA = Camera(525.0, 525.0, 79.5, 59.5, 160, 120)
_FRAME_NS = 100_000_000


def warm_up(stage: str | None = None, colour: bool | None = None) -> None:
    """Compile everything, and load what a stage needs; seconds once per machine, for one process.

    Args:
        stage: preprocess, odometry or closure; None: all of them, and the models.
        colour: whether the input may have it; None: unless ``WITHOUT_COLOUR`` is set.
    """
    coloured = not os.environ.get(WITHOUT_COLOUR) if colour is None else colour
    load = _STAGES[stage] if stage else _scan_something
    part = '' if coloured else 'without_colour'
    compile_once(cache_folder(), partial(_compile, coloured), partial(load, coloured), part)
    # a logger names its caller by this; the first call inspects the files of all modules
    inspect.getframeinfo(sys._getframe())


def _compile(coloured: bool) -> None:
    """Everything, half of it in a process of its own: what one has compiled the other loads."""
    path = [os.fspath(PACKAGE.parent), *sys.path]
    track = f'import sys; sys.path[:] = {path!r}; from {__name__} import compile_tracking; compile_tracking()'
    beside = subprocess.Popen([sys.executable, '-c', track], stdin=subprocess.DEVNULL)
    try:
        _build(_describe(coloured))
    finally:
        beside.wait()
    _scan_something(coloured)


def compile_tracking() -> None:
    """Compile what it takes to track a target by its depth."""
    _track(coloured=False)


def _preprocess(coloured: bool) -> None:
    for _ in _target_frames(coloured):
        pass
    _rectify()


def _rectify() -> None:
    from debris_scanner.sensing.rectification import Distortion, Rectifier

    lens = Distortion.of('plumb_bob', [0.01, 0.0, 0.0, 0.0, 0.0])
    if lens is not None:
        Rectifier(_CAMERA, lens).depth(_bumps(0))


def _track(coloured: bool) -> None:
    """Follow a target, then track a model of it, and forecast."""
    importlib.import_module('scipy.optimize')  # the forecast's, which comes with a later frame
    odometry = make_odometry(Settings())
    first, second, third = _target_frames(coloured)
    odometry.process(first)
    odometry.process(second)
    view = odometry.keyframes.views[0]
    nothing = np.zeros((0, 3), np.float32)
    model = Model(view.points, view.normals, nothing, nothing.astype(np.int32))
    odometry.adopt_model(model, {k.stamp_ns: k.T_target_sensor for k in odometry.keyframes.frames})
    odometry.process(third)
    _forecast()


def _describe(coloured: bool) -> KeyFrameSet:
    """Describe key frames, and verify a closure between them."""
    from debris_scanner.mapping.closures import verify

    settings = Settings()
    detector = make_closure_detector(settings)
    for frame in _target_frames(coloured):
        detector.add(KeyFrame(frame, np.eye(4), 0.0))
    a, b = detector.keyframes.views[:2]
    verify(b, np.eye(4), a, np.eye(4), settings.verification)
    return detector.keyframes


def _build(keyframes: KeyFrameSet) -> Model:
    """A closed model of key frames."""
    from debris_scanner.modelling.closing import close
    from debris_scanner.modelling.refinement import integrated, large_parts, make_model
    from debris_scanner.registration.offset_terms import OffsetEquations
    from debris_scanner.sensing.depth_offset import NO_OFFSET

    OffsetEquations([keyframes.views[0]], [np.eye(4)], NO_OFFSET).add_pair(0, 0, 1.0, 1.0)
    volume = integrated(keyframes.posed, Settings().fusion)
    surface = large_parts(volume.surface())
    if surface is None:
        raise RuntimeError('the synthetic target of the warm-up leaves no surface')
    return make_model(surface, [], np.zeros(3), close(volume, keyframes.posed))[0]


_STAGES: dict[str, Callable[[bool], object]] = {
    'preprocess': _preprocess,
    'odometry': _track,
    'closure': _describe,
}


def _scan_something(coloured: bool) -> None:
    """Scan and track three frames of a small synthetic target, and make its model."""
    from debris_scanner.scanner import Scanner

    _rectify()
    scanner = Scanner(Settings())
    first, second, third = _depth_frames(coloured)
    estimate = scanner.process(first).estimate
    scanner.process(second)
    if estimate is None or estimate.keyframe is None:
        raise RuntimeError('the synthetic target of the warm-up makes no key frame')
    scanner.front_end.detector.add(estimate.keyframe)
    model = _build(scanner.back_end.builder.graph.keyframes)
    scanner.front_end.odometry.adopt_model(
        model, {k.stamp_ns: k.T_target_sensor for k in scanner.back_end.builder.keyframes}
    )
    scanner.process(third)
    scanner.finish()
    _forecast()


def _forecast() -> None:
    """Fit a body to a rate, and let it turn."""
    from debris_scanner.core.rigid_body import fit_rates, propagate

    propagate(np.eye(3), np.ones(3), np.eye(3), np.ones(1))
    fit_rates(np.eye(3)[None], np.ones((1, 3)), np.ones(1))


def _target_frames(coloured: bool) -> Iterator[TargetFrame]:
    preprocessor = make_preprocessor(Settings())
    return (preprocessor.process(frame) for frame in _depth_frames(coloured))


def _depth_frames(coloured: bool) -> list[DepthFrame]:
    rgb = [_stripes(k) if coloured else None for k in range(3)]
    return [DepthFrame((k + 1) * _FRAME_NS, _bumps(k), _CAMERA, rgb[k]) for k in range(3)]


def _stripes(step: int) -> NDArray[np.uint8]:
    """Colours (120, 160, 3) of the disc."""
    v, u = np.mgrid[:120, :160]
    waves = np.stack([np.sin((u - step) / 5), np.cos(v / 6), np.sin((u - step + v) / 8)], axis=-1)
    return (130 + 80 * waves).astype(np.uint8)


def _bumps(step: int) -> NDArray[np.float32]:
    """Depth (120, 160), metres, of a bumpy disc that moves a little with each step."""
    v, u = np.mgrid[:120, :160].astype(np.float32)
    u = u - 80 - step
    v = v - 60
    disc = u**2 + v**2 < 45**2
    depth = 0.8 + 0.01 * np.sin(u / 7) * np.cos(v / 9) + (u**2 + v**2) * 1e-5
    return np.where(disc, depth, 0).astype(np.float32)
