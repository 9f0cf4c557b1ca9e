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

"""``scan --view``: the page of a live scan, fed by the offline scan in this process."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from debris_scanner.back_end import phase_of
from debris_scanner.cli.errors import CliError
from debris_scanner.core.frames import TargetFrame
from debris_scanner.io.mesh_files import decimated
from debris_scanner.io.outcome import outcome_rows
from debris_scanner.io.result_files import SUMMARY
from debris_scanner.viewer.drawing import by_direction, lit, thinned
from debris_scanner.viewer.presenter import (
    FRAMES,
    SCANNING_FRAME,
    TARGET_FRAME,
    Placed,
    ScanPresenter,
    cloud_of,
)
from debris_scanner.viewer.scene import ScanScene
from debris_scanner.viewer.server import (
    LOOPBACK,
    TICK_S,
    ViewerError,
    linger,
    open_server,
    result_links,
    url_of,
)

if TYPE_CHECKING:
    from debris_scanner.core.frames import DepthFrame
    from debris_scanner.interruption import Interruption
    from debris_scanner.modelling.generation import Generation
    from debris_scanner.scanner import Scanner, Step

EVERY_S = 0.2
MOST_POINTS, MOST_TRIANGLES = 20_000, 40_000  # drawn of a cloud, and of a mesh


class ScanView:
    """Shows an offline scan; there is nothing to press, as Ctrl-C ends the scan.

    Args:
        port: to serve on, on this machine alone.
        folder: of the results.

    Raises:
        CliError: the library is missing, or the port is in use.
    """

    def __init__(self, port: int, folder: Path) -> None:
        try:
            self._server = open_server(LOOPBACK, port, folder)
        except ViewerError as error:
            raise CliError(f'--view: {error}') from None
        self._folder = folder
        self._scene = ScanScene(self._server, FRAMES)
        self._presenter = ScanPresenter(self._scene)
        self._drawn_s = 0.0
        print(f'debris-scan scan: the scan is shown at {url_of(self._server)}', file=sys.stderr)

    def show(self, frame: 'DepthFrame', step: 'Step', scanner: 'Scanner') -> None:
        """One frame and what came of it."""
        estimate = step.estimate
        if estimate is not None:
            name = TARGET_FRAME if estimate.tracked else SCANNING_FRAME
            self._presenter.follow(estimate.stamp_ns, name, estimate.T_sensor_target)
            if estimate.keyframe is not None and step.target is not None:
                points, normals, _ = cloud_of(step.target)
                self._presenter.add_keyframe(estimate.stamp_ns, points, normals)
        rejected = {} if step.rejected is None else {step.rejected: 1}
        self._presenter.know(state=scanner.state, rejected=rejected, received=1)
        if step.generation is not None:
            self._show_model(step.generation)
        now = time.monotonic()
        if now - self._drawn_s < EVERY_S or not self._server.get_clients():
            return
        self._drawn_s = now
        if step.target is not None:
            self._show_target(step.target, frame)
        if estimate is not None:
            rate = float(np.degrees(np.linalg.norm(estimate.omega_target)))
            self._presenter.show_pose(Placed(name, estimate.T_sensor_target), rate)
        self._scene.show_readings({'Frames': str(scanner.frames_used), 'Key frames': str(scanner.keyframes)})
        self._presenter.refresh()

    def generating(self, what: str, done: int, total: int) -> None:
        """The last model is being made."""
        now = time.monotonic()
        if now - self._drawn_s > EVERY_S:
            self._drawn_s = now
            self._presenter.know(phase=phase_of(what, done, total))
            self._presenter.refresh()

    def conclude(self, last: 'Generation | None', written: Path) -> None:
        """Show the result, which has been written into a folder."""
        if last is not None:
            self._show_model(last)
        summary = json.loads((written / SUMMARY).read_text(encoding='utf-8'))
        links = result_links(written) if written == self._folder else []  # that folder alone is served
        self._presenter.conclude(summary, outcome_rows(summary), links)

    def linger(self, interruption: 'Interruption') -> None:
        """Keep the page until nobody looks any more, or Ctrl-C (another one, if one ended the scan)."""
        before = interruption.requested

        def watched() -> bool:
            time.sleep(TICK_S)
            return bool(self._server.get_clients())

        linger('debris-scan scan', url_of(self._server), watched, lambda: interruption.requested != before)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _show_target(self, target: TargetFrame, frame: 'DepthFrame') -> None:
        points, normals, rgb = cloud_of(target)
        some = thinned(len(points), MOST_POINTS)
        colours = lit(points[some], normals[some]) if rgb is None else rgb[some]
        self._scene.show_target(points[some], colours)
        self._presenter.show_window(target, frame.camera)

    def _show_model(self, generation: 'Generation') -> None:
        model = generation.model
        if model is None:
            return
        poses = sorted(generation.poses.items())
        self._presenter.place_model(poses)
        some = thinned(len(model.points), 3 * MOST_POINTS)
        colours = by_direction(model.normals) if model.rgb is None else model.rgb
        self._scene.show_model(TARGET_FRAME, model.points[some], colours[some], seen=model.rgb is not None)
        nodes = np.array([T[:3, 3] for _, T in poses], np.float32).reshape(-1, 3)
        edges = [] if generation.optimised is None else generation.optimised.edges
        pairs = {c: [(e.i, e.j) for e in edges if e.is_closure == c] for c in (False, True)}
        chain, closures = (nodes[np.array(pairs[c], int).reshape(-1, 2)] for c in (False, True))
        self._scene.show_graph(TARGET_FRAME, nodes, chain, closures)
        self._scene.show_seen(SCANNING_FRAME, model.points[:0], colours[:0])
        vertices, triangles = decimated(model.vertices.astype(np.float64), model.triangles, MOST_TRIANGLES)
        self._scene.show_mesh(TARGET_FRAME, vertices.astype(np.float32), triangles)
        self._presenter.show_model_text(len(model.points), len(model.triangles))
