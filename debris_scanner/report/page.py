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

"""The page: sections, figures and the plotting library in one file that needs no network."""

import base64
import gzip
import json
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from debris_scanner.report import fragments
from debris_scanner.report.explanations import SIDES_NAMED, coverage_words, explain
from debris_scanner.report.forecast_plots import forecast_plot, polhode_plot
from debris_scanner.report.frame_view import frame_view
from debris_scanner.report.graph_plots import graph_plots
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.similarity_plots import similarity_plots
from debris_scanner.report.space_plots import model_plot, track_plot
from debris_scanner.report.style import Plot
from debris_scanner.report.time_plots import drift_plot, rate_plot, timing_plot
from debris_scanner.report.truth import Truth

BYTE = 255
# With this policy the browser lets the page load nothing.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


def render(scan: ScanOutput, truth: Truth | None = None) -> str:
    """The report as HTML."""
    sections = [
        ('outcome', 'Outcome', fragments.verdict(scan) + fragments.tiles(scan)),
        ('model-section', 'Model', _model(scan)),
        ('figures', 'Figures', _figures(scan)),
        ('motion', 'Motion', _motion(scan, truth)),
        ('ahead', 'Forecast', _ahead(scan)),
        ('similarity', 'Similarity', _similarity(scan, truth)),
        ('closures', 'Closures', _closures(scan)),
        ('graph', 'Pose graph', _graph(scan)),
        ('observer', 'Observer', _observer(scan)),
        ('time', 'Timing', _timing(scan)),
        ('about', 'About', _about(scan)),
    ]
    return _document(scan.name, sections)


def _document(name: str, sections: list[tuple[str, str, str]]) -> str:
    links = ''.join(f'<a href="#{key}">{title}</a>' for key, title, _ in sections)
    body = ''.join(
        f'<section id="{key}">{"" if key == "outcome" else f"<h2>{title}</h2>"}{content}</section>'
        for key, title, content in sections
    )
    own = files('debris_scanner.report')
    style, script = (own.joinpath(f'page.{kind}').read_text(encoding='utf-8') for kind in ('css', 'js'))
    title = f'Scan report: {escape(name)}'
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n'
        f'<header><h1>{title}</h1><button type="button" id="theme" title="light or '
        f'dark">◐</button></header>\n<nav>{links}</nav>\n<main>\n{body}\n</main>\n'
        f'<script type="text/plain" id="library">{_library()}</script>\n'
        f'<script>\n{script}</script>\n</body>\n</html>\n'
    )


@cache
def _library() -> str:
    """The plotting library as the page carries it: gzip in base64, which is two fifths of its size."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


def _plots(plots: list[Plot], otherwise: str) -> str:
    if not plots:
        return _absent(otherwise)
    return f'<div class="plots">{"".join(_plot(p) for p in plots)}</div>'


def _plot(plot: Plot) -> str:
    content = json.loads(plot.figure.to_json())
    for trace in content['data']:
        _shorten(trace)
    figure = fragments.script_json(content)
    buttons = ''.join(
        f'<button type="button" data-visible="{json.dumps(c.visible)}" aria-pressed="{str(k == 0).lower()}">'
        f'{escape(c.label)}</button>'
        for k, c in enumerate(plot.choices)
    )
    choices = f'<div class="choices" role="group" aria-label="shown">{buttons}</div>' if buttons else ''
    kind = 'plot scene' if 'scene' in content['layout'] else 'plot'
    return (
        f'<figure class="{plot.shape}"><h3>{plot.title}</h3>{choices}{_views(plot) if kind != "plot" else ""}'
        f'<div class="{kind}" id="{plot.key}" style="height:{plot.height}px"></div>'
        f'<script type="application/json" data-for="{plot.key}">{figure}</script>'
        f'<figcaption>{plot.caption}</figcaption></figure>'
    )


def _shorten(trace: dict[str, Any]) -> None:
    """Send probabilities of pairs as bytes: matrices grow with the square, and no finer colour shows."""
    z = trace.get('z')
    if trace['type'] != 'heatmap' or not isinstance(z, dict) or z['dtype'] not in ('f4', 'f8'):
        return
    n = int(z['shape'].split(',')[0])
    values = np.frombuffer(base64.b64decode(z['bdata']), z['dtype'])
    if len(values) != n * n or not (n and values.min() >= 0 and values.max() <= 1):  # NaN included
        return
    # of symmetric matrices the lower half
    half = np.rint(BYTE * values.reshape(n, n)[np.tril_indices(n)]).astype(np.uint8)
    trace['z'] = []
    trace['meta'] = {'size': n, 'steps': BYTE, 'half': base64.b64encode(half.tobytes()).decode()}


def _views(plot: Plot) -> str:
    """Buttons that turn a scene to its first view and to one side, and a hint on how to turn it by hand."""
    buttons = ''.join(
        f'<button type="button" data-camera="{escape(json.dumps(camera))}">{label}</button>'
        for label, camera in [('Reset', None), *((v.label, v.camera) for v in plot.views)]
    )
    return f'<div class="views" role="group" aria-label="seen from">{buttons}<span class="hint"></span></div>'


def _model(scan: ScanOutput) -> str:
    if scan.surface is not None:
        return f'<p class="seen">{_coverage(scan)}</p>' + _plots([model_plot(scan.surface)], '')
    if scan.summary['result'] == 'model':
        return _absent('The scan has a model, but mesh.ply or model.ply no longer lies beside its summary.')
    why = explain(scan.summary.get('reason'))
    return _absent(f'<b>There is no model to turn.</b> {escape(why.meaning)}')


def _coverage(scan: ScanOutput) -> str:
    """How much of the closed surface was seen, in one sentence, or that there is none."""
    coverage = scan.summary.get('coverage')
    painted = scan.surface is not None and scan.surface.observed is not None
    if not painted:
        return (
            'This folder holds no closed mesh (<code>mesh_closed.ply</code>): below is what was seen, '
            'with its holes, and what nobody saw is not painted.'
        )
    if coverage is None:
        return 'The summary does not say how much of the closed surface was seen; its faces below do.'
    return f'{escape(coverage_words(coverage))} <small>{SIDES_NAMED}</small>'


def _figures(scan: ScanOutput) -> str:
    if scan.metrics is None:
        return _absent(
            'This result has not been compared with the truth. Where the recording has its truth beside it, '
            '<code>debris-scan report DIR --truth BAG</code> does so.'
        )
    return fragments.figures_table(scan.metrics) + _caption(
        'Errors over all frames after one constant alignment of the target frame, and of the model after '
        'that same alignment and no other. Completeness is the share of the surface that was seen and lies '
        "within 3 mm of the model. <b>Look for</b> an error of the model well below the sensor's own noise "
        'at one pixel, and for no false closure.'
    )


def _motion(scan: ScanOutput, truth: Truth | None) -> str:
    plots = [p for p in (rate_plot(scan, truth), drift_plot(scan, truth)) if p is not None]
    return frame_view(scan) + _plots(plots, 'Fewer than two frames have an estimate.')


def _ahead(scan: ScanOutput) -> str:
    plots = [p for p in (forecast_plot(scan), polhode_plot(scan)) if p is not None]
    return _plots(plots, 'There is no forecast without a model and a motion that was measured.')


def _similarity(scan: ScanOutput, truth: Truth | None) -> str:
    if scan.matrices is None:
        absent = (
            'The descriptors of the key frames were not kept: <code>closure_probabilities.npz</code> is '
            'missing. Every scan that ends writes it; scan the recording again.'
        )
    else:
        absent = 'Fewer than two key frames were described, so there is nothing to compare.'
    return _plots(similarity_plots(scan, truth), absent)


def _closures(scan: ScanOutput) -> str:
    if not scan.closures:
        return _absent(
            'No hypothesis was tried: no key frame had turned far enough from an earlier one, or none looked '
            'from nearby.'
        )
    return fragments.closure_table(scan) + _caption(
        'Every hypothesis that was verified by registering the two views. Click a heading to sort; a tooltip '
        'on the reason has the full record, one on the turn the registered pose. One number beyond its bound '
        'refuses a closure. <b>Look for</b> accepted ones with a large overlap and small corrections. '
        'Refused only for being <em>apart</em> means that the views fit but the loop was not quite closed.'
    )


def _graph(scan: ScanOutput) -> str:
    return _plots(graph_plots(scan), 'Fewer than two key frames make no graph.')


def _observer(scan: ScanOutput) -> str:
    track = track_plot(scan)
    return _plots([track] if track else [], 'Fewer than two frames have a pose.')


def _timing(scan: ScanOutput) -> str:
    timing = scan.summary.get('timing') or {}
    plot = timing_plot(timing)
    if plot is None:
        return _absent('No stage ran.')
    return (
        _plots([plot], '')
        + f'<details><summary>All stages</summary>{fragments.timing_table(timing)}</details>'
    )


def _about(scan: ScanOutput) -> str:
    versions = scan.summary.get('versions') or {}
    rows = [[name, str(version)] for name, version in versions.items()]
    libraries = fragments.table(['library', 'version'], rows)
    return (
        _caption(
            'Metres, radians and seconds unless an axis says otherwise. The target frame has the attitude of '
            "the first key frame and its origin at the model's centroid; the sensor frame is optical: x "
            'right, y down, z forward. A <em>key frame</em> is kept because the target had turned '
            'enough. A <em>closure</em> is the finding that two key frames show the same face. The page is '
            'one file and loads nothing from the network.'
        )
        + f'<details><summary>Versions</summary>{libraries}</details>'
    )


def _caption(text: str) -> str:
    return f'<p class="caption">{text}</p>'


def _absent(text: str) -> str:
    return f'<p class="absent">{text}</p>'
