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

"""The scan as a scene with a panel of readings, the same for everyone who opens the page."""

import threading
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, inverse, to_quaternion
from debris_scanner.viewer.drawing import (
    GRAZED,
    SEEN_COLOUR,
    TARGET_COLOUR,
    WELL_SEEN,
    Colours,
    Points,
    coverage_parts,
    drawn_in,
    extent_of,
    frusta,
)
from debris_scanner.viewer.panel import Panel

if TYPE_CHECKING:
    import viser

TARGET, SEEN, MODEL, MESH = 'Target now', 'Seen so far', 'Model cloud', 'Model mesh'
GRAPH, AXES = 'Key frames', 'Axes'
GHOST = 'In ten seconds'
LAYERS = (TARGET, SEEN, MODEL, MESH, GRAPH, GHOST, AXES)
OFF_AT_FIRST = (MODEL, GHOST, AXES)
_SENSOR, _STILL = 'sensor', 'target'

_NODE, _EDGE, _CLOSURE, _RIM = (70, 150, 255), (90, 90, 100), (225, 90, 220), (255, 60, 50)
_GHOST = (90, 130, 190)
LEGEND = (
    (TARGET_COLOUR, 'seen now'),
    (SEEN_COLOUR, 'seen so far'),
    (WELL_SEEN, 'model, well seen'),
    (GRAZED, 'seen only at a grazing angle'),
    (_RIM, 'rim of what nobody saw'),
    (_NODE, 'key frames (direction)'),
    (_CLOSURE, 'loop closures'),
)
_START = np.array([2.7, -2.1, -3.3])  # of the camera, from the target, in its radii; y down, z away
_RADIUS = 0.15  # m, until a target is seen
_VIEW_RAD = 0.7
_AHEAD = np.array([0.0, 0.0, 0.8])  # m: where a target is expected


class Layer:
    """What a layer has drawn, and the check box that shows or hides all of it."""

    def __init__(self, box: 'viser.GuiCheckboxHandle') -> None:
        self.box = box
        self.drawn: dict[str, Any] = {}  # handles of viser, by a name within the layer
        self._lock = threading.RLock()  # clicks arrive in other threads
        box.on_update(lambda _: self._switch())

    def add(self, key: str, make: Callable[[], Any]) -> None:
        """Draw what ``make`` returns the handle of."""
        with self._lock:
            handle = make()
            handle.visible = self.box.value
            self.drawn[key] = handle

    def drop(self, key: str) -> None:
        """Remove a drawn thing, if there is one of this name."""
        with self._lock:
            if (handle := self.drawn.pop(key, None)) is not None:
                handle.remove()

    def empty(self) -> None:
        """Remove everything."""
        for key in list(self.drawn):
            self.drop(key)

    def _switch(self) -> None:
        with self._lock:
            for handle in self.drawn.values():
                handle.visible = self.box.value


class ScanScene:
    """Draws layers; each call replaces what the layer showed before.

    Everything lies in the sensor's optical frame: the target's cloud directly, the rest in a target frame.
    Of several target frames the one of the last pose is shown.

    Args:
        server: owner of scene and panel.
        target_frames: names of the target frames.
        press: called with the name of a control that is pressed; None: the page has no controls.
    """

    def __init__(
        self,
        server: 'viser.ViserServer',
        target_frames: Iterable[str],
        press: Callable[[str], None] | None = None,
    ) -> None:
        self._server = server
        self._T_sensor_target: Array = np.eye(4)
        self._aimed = self._coloured = False
        self._radius = 0.0  # m, of the target; 0 until it is seen
        self._graph: tuple[str, Points, Points, Points] | None = None
        self._mesh: tuple[str, Points, NDArray[np.int32]] | None = None
        self._surface = np.zeros((0, 3), np.float32)  # of the model, for its ghost
        scene = server.scene
        scene.set_up_direction('-y')
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)
        server.gui.configure_theme(dark_mode=True, show_share_button=False, show_logo=False)
        server.gui.main_panel.dock_right()  # beside the scene, not on it
        scene.set_background_image(np.full((1, 1, 3), 26, np.uint8))
        self._sensor = scene.add_frame('/sensor', axes_length=0.1, axes_radius=0.002, show_axes=False)
        self._frames = {
            name: scene.add_frame(
                f'/{name}', axes_length=0.12, axes_radius=0.0025, show_axes=False, visible=False
            )
            for name in target_frames
        }
        self.panel = Panel(server, press, LEGEND)
        # open, for a folder that is closed cannot be opened from the keyboard
        with server.gui.add_folder('Layers', order=9.0):
            self._layers = {
                name: Layer(server.gui.add_checkbox(name, name not in OFF_AT_FIRST)) for name in LAYERS
            }
            self._still = server.gui.add_dropdown('Hold still', (_SENSOR, _STILL), initial_value=_SENSOR)
        self._layers[AXES].box.on_update(lambda _: self._show_axes())
        self._still.on_update(lambda _: self._place())
        server.initial_camera.fov = _VIEW_RAD
        self._aim(_AHEAD)

    def show_target(self, points: Points, colours: Colours) -> None:
        """The target as it is seen now: points (n, 3), metres, sensor frame."""
        if not len(points):
            self._layers[TARGET].drop('points')
            return
        self._measure(points)
        self._cloud(TARGET, '/sensor/target_points', points, colours, 0.015)
        if not self._aimed:
            self._aimed = True
            self._aim(points.mean(axis=0, dtype=np.float64))

    def show_seen(self, frame: str, points: Points, colours: Colours) -> None:
        """What key frames have shown so far: points (n, 3), metres, target frame."""
        self._layers[SEEN].drop('points')
        if len(points):
            self._cloud(SEEN, f'/{frame}/seen', points, colours, 0.012)

    def show_pose(self, frame: str, T_sensor_target: Array) -> None:
        """Pose (4, 4) of one of the target frames, which is shown from now on."""
        self._T_sensor_target = T_sensor_target
        with self._server.atomic():
            for name, handle in self._frames.items():
                if handle.visible != (name == frame):
                    handle.visible = name == frame
            self._place()

    def show_graph(self, frame: str, nodes: Points, edges: Points, closures: Points) -> None:
        """Sensor positions (k, 3) at key frames, target frame; lines (n, 2, 3) between them."""
        self._graph = frame, nodes, edges, closures
        self._draw_graph()
        self._paint_mesh()

    def _draw_graph(self) -> None:
        self._layers[GRAPH].empty()
        if self._graph is None:
            return
        frame, nodes, edges, closures = self._graph
        root = f'/{frame}/graph'
        radius = self._radius or _RADIUS
        for key, lines, colour, width in (
            ('edges', drawn_in(edges, radius), _EDGE, 1.0),
            ('nodes', frusta(nodes, radius), _NODE, 1.5),
            ('closures', drawn_in(closures, radius), _CLOSURE, 1.5),
        ):
            if len(lines):
                self._layers[GRAPH].add(key, self._lines(f'{root}/{key}', lines, colour, width))

    def show_model(self, frame: str, points: Points, colours: Colours, seen: bool = False) -> None:
        """The model's cloud: points (n, 3), metres, target frame.

        Args:
            frame: the target frame.
            points: metres.
            colours: (n, 3).
            seen: the colours are the target's own. The mesh does not show them, so the cloud is switched on.
        """
        self._layers[MODEL].drop('points')
        self._layers[GHOST].drop('points')
        self._surface = points
        self._measure(points)
        if seen and not self._coloured:
            self._layers[MODEL].box.value = self._coloured = True
        if len(points):
            self._cloud(MODEL, f'/{frame}/model', points, colours, 0.011)

    def show_forecast(self, T_sensor_target: Array) -> None:
        """The model's ghost, where the target is expected in ten seconds: pose (4, 4)."""
        if not len(self._surface):
            return
        if 'points' not in self._layers[GHOST].drawn:
            colours = np.full(self._surface.shape, _GHOST, np.uint8)
            self._cloud(GHOST, '/sensor/ghost', self._surface, colours, 0.008)
        _move(self._layers[GHOST].drawn['points'], T_sensor_target)

    def show_mesh(self, frame: str, vertices: Points, triangles: NDArray[np.int32]) -> None:
        """The model's mesh: vertices (m, 3), metres, target frame; triangles (t, 3)."""
        self._mesh = (frame, vertices, triangles) if len(triangles) else None
        self._paint_mesh()

    def _paint_mesh(self) -> None:
        """Draw the mesh, painted by how well the key frames of its own frame saw it."""
        self._layers[MESH].empty()
        if self._mesh is None:
            return
        frame, vertices, triangles = self._mesh
        graph = self._graph
        sensors = graph[1] if graph is not None and graph[0] == frame else np.zeros((0, 3), np.float32)
        parts, rims = coverage_parts(vertices, triangles, sensors)
        for k, (colour, part) in enumerate(parts):
            self._layers[MESH].add(f'mesh {k}', self._mesh_part(f'/{frame}/mesh_{k}', vertices, part, colour))
        if len(rims):
            self._layers[MESH].add('rims', self._lines(f'/{frame}/rims', rims, _RIM, 2.0))

    def _mesh_part(
        self, path: str, vertices: Points, triangles: NDArray[np.int32], colour: tuple[int, int, int]
    ) -> Callable[[], Any]:
        used, index = np.unique(triangles, return_inverse=True)
        return lambda: self._server.scene.add_mesh_simple(
            path, vertices[used], index.reshape(-1, 3), color=colour, side='double', cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip

    def _measure(self, points: Points) -> None:
        """Learn the target's size; what depends on it is drawn again if it has grown."""
        radius = extent_of(points)
        if radius > 1.2 * self._radius:
            self._radius = radius
            self._draw_graph()

    def show_readings(self, values: Mapping[str, str]) -> None:
        """Texts of the panel, shown literally: markup in them has no effect."""
        self.panel.show_readings(values)

    def clear(self) -> None:
        """Start a new scan."""
        self._surface = self._surface[:0]
        self._graph = self._mesh = None
        self._radius = 0.0
        self._aimed = False
        with self._server.atomic():
            for layer in self._layers.values():
                layer.empty()
            for handle in self._frames.values():
                handle.visible = False
        self.panel.clear()

    def _cloud(self, name: str, path: str, points: Points, colours: Colours, share: float) -> None:
        """Show a cloud, its points a share of the target's radius large.

        An existing one is changed in place, because a new one would flicker.
        """
        size = share * (self._radius or _RADIUS)
        old = self._layers[name].drawn.get('points')
        if old is not None:
            with self._server.atomic():
                old.points, old.colors = points, colours
            return
        self._layers[name].add(
            'points',
            lambda: self._server.scene.add_point_cloud(
                path, points, colours, point_size=size, point_shape='circle', precision='float32',
                point_shading='flat',
            ),
        )  # fmt: skip

    def _lines(
        self, path: str, lines: Points, colour: tuple[int, int, int], width: float
    ) -> Callable[[], Any]:
        return lambda: self._server.scene.add_line_segments(
            path, lines, colour, thickness=width, thickness_units='screen'
        )

    def _show_axes(self) -> None:
        for frame in (self._sensor, *self._frames.values()):
            frame.show_axes = self._layers[AXES].box.value

    def _place(self) -> None:
        """Set the frames' poses. A target held still stays where it was first seen; then the sensor moves."""
        T_world_sensor = np.eye(4)
        if self._still.value == _STILL:
            T_world_sensor[:3, 3] = self._centre
            T_world_sensor = T_world_sensor @ inverse(self._T_sensor_target)
        _move(self._sensor, T_world_sensor)
        for frame in self._frames.values():
            _move(frame, T_world_sensor @ self._T_sensor_target)

    def _aim(self, centre: Array) -> None:
        """Point the camera of all pages, open and future, at the target."""
        self._centre = centre
        start = centre + _START * (self._radius or _RADIUS)
        self._server.initial_camera.position = start
        self._server.initial_camera.look_at = centre
        self._server.initial_camera.near = 0.01
        for client in self._server.get_clients().values():
            client.camera.position = start
            client.camera.look_at = centre


def _move(handle: Any, T: Array) -> None:
    x, y, z, w = to_quaternion(T[:3, :3]).tolist()
    handle.wxyz, handle.position = (w, x, y, z), T[:3, 3]
