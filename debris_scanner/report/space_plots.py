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

"""Three-dimensional figures: the model, and the sensor's path around it."""

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.report.scan_output import Painted, ScanOutput, Surface
from debris_scanner.report.style import GRID, INK, MUTED, ORANGE, RED, Choice, Plot, View, figure, thinned

MOST_POINTS = 30_000
SEEN, UNSEEN = 'seen', 'never seen, filled in'
UNSEEN_COLOUR = 'var(--unseen)'
_LIGHT = {'ambient': 0.3, 'diffuse': 0.62, 'specular': 0.1, 'roughness': 0.8, 'fresnel': 0.05}
_LAMP = {'x': -5000, 'y': -6000, 'z': 3000}
# The target frame is the sensor's optical frame at the first key frame: y down, z away from the sensor.
_UP = {'x': 0, 'y': -1, 'z': 0}
_FROM = np.array([0.50, -0.28, -0.82])  # unit; much as the sensor saw it first
_FROM_ABOVE = np.array([0.62, -0.62, -0.48])  # unit; the sensor's own way is seen from aside
_FLATTEST = 0.35  # side of a scene, in lengths of its longest one
_DISTANCE = 1.35  # of the eye, in lengths of the scene's longest side
_STRAIGHT = 1.9  # the same where a side faces the eye: its near edges must be in view


def _from_side(label: str, eye: tuple[int, int, int], up: tuple[int, int, int]) -> View:
    far = [_STRAIGHT * v for v in eye]
    return View(label, {'up': dict(zip('xyz', up, strict=True)), 'eye': dict(zip('xyz', far, strict=True))})


VIEWS = (
    _from_side('Front', (0, 0, -1), (0, -1, 0)),
    _from_side('Back', (0, 0, 1), (0, -1, 0)),
    _from_side('Left', (-1, 0, 0), (0, -1, 0)),
    _from_side('Right', (1, 0, 0), (0, -1, 0)),
    _from_side('Top', (0, -1, 0), (0, 0, 1)),
    _from_side('Bottom', (0, 1, 0), (0, 0, -1)),
)


def model_plot(surface: Surface) -> Plot:
    """Mesh and cloud of the model, either or both; of a closed mesh what nobody saw is painted."""
    mesh = surface.coarse
    step = -(-len(surface.points) // MOST_POINTS)  # rounded up
    few, rgb = surface.points[::step], None if surface.rgb is None else surface.rgb[::step]
    fig = _scene(surface.points * 1e3, _FROM)
    _add_painted(fig, mesh, None if rgb is None else rgb[cKDTree(few).query(mesh.vertices)[1]])
    x, y, z = (few * 1e3).astype(np.float32).T
    tint: dict[str, object] = {'color': z, 'colorscale': 'Viridis'} if rgb is None else {'color': _hex(rgb)}
    fig.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode='markers',
        marker={'size': 1.6, **tint},
        name='cloud',
        visible=False,
        hovertemplate='%{x:.0f}, %{y:.0f}, %{z:.0f} mm<extra></extra>',
    )
    n = len(fig.data) - 1  # meshes; the cloud comes after them
    painted = tuple(range(n))
    if n > 1:
        shown = {'Closed': painted, 'Seen only': (0,), 'Cloud': (n,), 'Cloud and seen': (0, n)}
    else:
        shown = {'Mesh': painted, 'Cloud': (n,), 'Both': (*painted, n)}
    choices = tuple(Choice(label, visible) for label, visible in shown.items())
    return Plot('model', 'The model', fig, _model_caption(surface, len(few)), 560, choices, views=VIEWS)


def _model_caption(surface: Surface, points: int) -> str:
    size = np.ptp(surface.points, axis=0) * 1e3
    said = f'It measures {size[0]:.0f} × {size[1]:.0f} × {size[2]:.0f} mm along the axes of its frame. '
    said += '<b>Look for</b> doubled walls and flaps, signs of a loop closed wrongly'
    if surface.observed is None:
        said += ', and for holes, which are faces that the sensor never saw. '
    else:
        said += f'. What is painted as <em>{UNSEEN}</em> is no measurement: it closes the gaps. '
    triangles = len(surface.coarse.triangles)
    if triangles < len(surface.triangles) or points < len(surface.points):
        file = 'mesh.ply' if surface.observed is None else 'mesh_closed.ply'
        said += (
            f'For this page the mesh is thinned to {triangles:,} of its {len(surface.triangles):,} '
            f'triangles and the cloud to {points:,} of {len(surface.points):,} points; '
            f'<code>{file}</code> and <code>model.ply</code> have all.'
        )
    return said


def track_plot(scan: ScanOutput) -> Plot | None:
    """The sensor's positions in the target frame, around the model where there is one."""
    if len(scan.poses) < 2:
        return None
    shown = [scan.poses[int(k)] for k in thinned(len(scan.poses))]
    eyes = np.array([inverse(p.T_sensor_target)[:3, 3] for p in shown]) * 1e3
    t = scan.seconds(np.array([p.stamp_ns for p in shown], dtype=np.int64))
    around = np.zeros((1, 3)) if scan.surface is None else scan.surface.points * 1e3
    fig = _scene(np.concatenate([eyes, around]), _FROM_ABOVE)
    if scan.surface is None:
        centre = {'size': 8, 'color': 'var(--model)', 'symbol': 'square'}
        fig.add_scatter3d(x=[0], y=[0], z=[0], mode='markers', name='target', marker=centre, hoverinfo='skip')
    else:
        fig.add_trace(_mesh(scan.surface.rough, 0.9, color='var(--model)'))
    known = {int(s) for s in scan.keyframes.stamps_ns}
    keys = np.array([k for k, p in enumerate(shown) if p.stamp_ns in known], dtype=int)
    _add_track(fig, eyes, t, keys)
    return Plot(
        'track',
        'The sensor around the target',
        fig,
        'To the target it is the sensor that goes round: its positions in the target frame, millimetres, '
        'from dark to bright over time. <b>Look for</b> a ring that meets itself after one turn. A spiral is '
        'drift, or an observer that really moves; a knot in one place is a target that does not turn, or '
        'whose turning cannot be seen.',
        520,
        views=VIEWS,
    )


def _add_track(fig: go.Figure, eyes: Array, t: Array, keys: NDArray[np.intp]) -> None:
    """Positions (n, 3), mm, by the time (n,), s; with key frames, by index, and where it started."""
    x, y, z = eyes.T
    fig.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode='lines+markers',
        name='sensor',
        line={'width': 3, 'color': MUTED},
        marker={
            'size': 3.5,
            'color': t,
            'colorscale': 'Plasma',
            'showscale': True,
            'colorbar': {'thickness': 12, 'outlinewidth': 0, 'title': {'text': 's'}, 'len': 0.7},
        },
        customdata=t,
        hovertemplate='%{customdata:.2f} s<extra></extra>',
        showlegend=False,
    )
    fig.add_scatter3d(
        x=x[keys],
        y=y[keys],
        z=z[keys],
        mode='markers',
        name=f'key frames ({len(keys)})',
        marker={'size': 6, 'color': ORANGE, 'symbol': 'diamond-open'},
        hoverinfo='skip',
    )
    fig.add_scatter3d(
        x=x[:1],
        y=y[:1],
        z=z[:1],
        mode='markers',
        name='start',
        marker={'size': 6, 'color': RED},
        hoverinfo='skip',
    )


def _add_painted(fig: go.Figure, mesh: Painted, rgb: Array | None) -> None:
    """What was seen, in the colours (m, 3) of its vertices if known, and apart from it what was not.

    The legend names both by words; where all was seen there is none.
    """
    for name, faces, colour in (
        (SEEN, mesh.observed, 'var(--model)'),
        (UNSEEN, ~mesh.observed, UNSEEN_COLOUR),
    ):
        if not faces.any():
            continue
        used, index = np.unique(mesh.triangles[faces], return_inverse=True)
        part = Painted(mesh.vertices[used], index.reshape(-1, 3).astype(np.int32), mesh.observed[faces])
        own = {} if rgb is None or name == UNSEEN else {'vertexcolor': _hex(rgb[used])}
        fig.add_trace(_mesh(part, 1.0, color=colour, **own))
        fig.data[-1].update(name=name, showlegend=not mesh.observed.all())


def _mesh(mesh: Painted, opacity: float, **colour: object) -> go.Mesh3d:
    x, y, z = (mesh.vertices * 1e3).astype(np.float32).T
    i, j, k = mesh.triangles.T
    return go.Mesh3d(
        x=x,
        y=y,
        z=z,
        i=i,
        j=j,
        k=k,
        opacity=opacity,
        lighting=_LIGHT,
        flatshading=False,
        name='mesh',
        lightposition=_LAMP,
        showlegend=False,
        hoverinfo='skip',
        **colour,
    )


def _scene(points: Array, direction: Array) -> go.Figure:
    """Axes and a camera that has all points (n, 3), millimetres, in view."""
    low, high = points.min(axis=0), points.max(axis=0)
    longest = float((high - low).max())
    sides = 1.06 * np.maximum(high - low, max(_FLATTEST * longest, 1e-6))
    axis = {
        'showbackground': False,
        'gridcolor': GRID,
        'zerolinecolor': GRID,
        'color': MUTED,
        'showspikes': False,
        'nticks': 6,
        'tickfont': {'size': 10},
    }
    axes = {}
    for name, middle, side in zip('xyz', (low + high) / 2, sides, strict=True):
        limits = [float(middle - side / 2), float(middle + side / 2)]
        axes[f'{name}axis'] = {**axis, 'title': {'text': f'{name}, mm'}, 'range': limits}
    ratio = dict(zip('xyz', (sides / sides.max()).tolist(), strict=True))
    camera = {'up': _UP, 'eye': dict(zip('xyz', (_DISTANCE * direction).tolist(), strict=True))}
    return figure(
        margin={'l': 0, 'r': 0, 't': 0, 'b': 0},
        scene={**axes, 'aspectmode': 'manual', 'aspectratio': ratio, 'camera': camera, 'dragmode': 'orbit'},
        legend={'orientation': 'h', 'x': 0, 'y': 1.02, 'yanchor': 'bottom', 'font': {'color': INK}},
    )


def _hex(rgb: Array) -> list[str]:
    values = np.clip(np.round(rgb * 255), 0, 255).astype(int)
    return [f'#{r:02x}{g:02x}{b:02x}' for r, g, b in values]
