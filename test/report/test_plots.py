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

"""Figures hold the numbers they are said to show."""

import base64
import dataclasses
import json

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import ClosureRecord, StampedPose
from debris_scanner.mapping.closure_matrices import MEASURES, ClosureMatrices
from debris_scanner.report.graph_plots import frame_graph, graph_plots, spiral
from debris_scanner.report.page import render
from debris_scanner.report.scan_output import MOST_TRIANGLES, Surface, read_scan
from debris_scanner.report.similarity_plots import closing_row, similarity_plots
from debris_scanner.report.space_plots import MOST_POINTS, VIEWS, model_plot, track_plot
from debris_scanner.report.style import MOST_SAMPLES, thinned
from debris_scanner.report.time_plots import drift_plot, rate_plot


@pytest.fixture(scope='module')
def scan(session_result):
    return read_scan(session_result)


def trace(plot, name):
    return next(t for t in plot.figure.data if t.name == name)


def sphere(n=160):
    """A closed mesh of about 2 n^2 triangles on the unit sphere."""
    u, v = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, n, endpoint=False), indexing='ij')
    points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n - 1), np.arange(n), indexing='ij'))
    a, b = i * n + j, i * n + (j + 1) % n
    return points, np.concatenate([np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)]).astype(
        np.int32
    )


def test_model_is_in_millimetres_and_coloured_as_the_cloud():
    vertices, triangles = sphere(20)
    points = np.repeat(sphere(20)[0], 100, axis=0)
    red = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    plot = model_plot(Surface(vertices * 0.1, triangles, points * 0.1, red))
    mesh, cloud = plot.figure.data
    assert np.abs(np.stack([mesh.x, mesh.y, mesh.z])).max() == pytest.approx(100, abs=1)
    assert set(mesh.vertexcolor) == set(cloud.marker.color) == {'#ff0000'}
    assert len(cloud.x) <= MOST_POINTS
    assert '199 × 199 × 200 mm' in plot.caption


def half_seen(n):
    """The unit sphere, of which the lower half, y > 0, was never seen."""
    vertices, triangles = sphere(n)
    return vertices, triangles, vertices[triangles].mean(axis=1)[:, 1] <= 0


@pytest.mark.parametrize('n', [20, 200])  # as it is, and thinned
def test_what_nobody_saw_is_painted_apart_and_named(n):
    vertices, triangles, observed = half_seen(n)
    red = np.tile([1.0, 0.0, 0.0], (len(vertices), 1))
    plot = model_plot(Surface(vertices, triangles, vertices, red, observed))
    seen, unseen, _ = plot.figure.data
    assert (seen.name, unseen.name) == ('seen', 'never seen, filled in')
    assert seen.showlegend and unseen.showlegend
    assert seen.color != unseen.color
    assert set(seen.vertexcolor) == {'#ff0000'} and unseen.vertexcolor is None
    assert np.max(seen.y) < 80 and np.min(unseen.y) > -80  # mm of 1000
    faces = len(seen.i) + len(unseen.i)
    assert len(unseen.i) / faces == pytest.approx(0.5, abs=0.05)
    assert faces <= MOST_TRIANGLES
    assert [(c.label, c.visible) for c in plot.choices] == [
        ('Closed', (0, 1)), ('Seen only', (0,)), ('Cloud', (2,)), ('Cloud and seen', (0, 2)),
    ]  # fmt: skip


def test_a_model_that_was_seen_whole_has_nothing_painted():
    vertices, triangles = sphere(20)
    plot = model_plot(Surface(vertices, triangles, vertices, None, np.ones(len(triangles), bool)))
    assert len(plot.figure.data) == 2 and not plot.figure.data[0].showlegend
    assert [c.label for c in plot.choices] == ['Mesh', 'Cloud', 'Both']


def test_a_side_looks_along_its_axis():
    eyes = {v.label: tuple(np.sign(list(v.camera['eye'].values()))) for v in VIEWS}
    assert eyes == {
        'Front': (0, 0, -1), 'Back': (0, 0, 1), 'Left': (-1, 0, 0), 'Right': (1, 0, 0), 'Top': (0, -1, 0),
        'Bottom': (0, 1, 0),
    }  # fmt: skip
    for view in VIEWS:
        eye, up = (np.array(list(view.camera[k].values())) for k in ('eye', 'up'))
        assert eye @ up == 0


def test_thinning_keeps_the_ends_and_what_matters():
    assert thinned(10).tolist() == list(range(10))
    assert thinned(0).tolist() == []
    keep = np.zeros(100_000, bool)
    keep[[17, 54_321]] = True
    chosen = thinned(len(keep), keep)
    assert len(chosen) <= MOST_SAMPLES + 2
    assert {0, 17, 54_321, 99_999} <= set(chosen.tolist())


def test_rate_has_three_sigma_and_marks_what_the_gate_rejected(scan):
    accepted = scan.rates.accepted.copy()
    accepted[[40, 41]] = False
    plot = rate_plot(
        dataclasses.replace(scan, rates=dataclasses.replace(scan.rates, accepted=accepted)), None
    )
    line = trace(plot, 'ω<sub>y</sub>')
    np.testing.assert_allclose(line.y, scan.rates.omega[:, 1])
    np.testing.assert_allclose(line.customdata, 3 * scan.rates.sigma[:, 1])
    band = plot.figure.data[2]  # before its line
    np.testing.assert_allclose(band.y[: len(line.y)], line.y + line.customdata)
    rejected = trace(plot, 'rejected by the gate (2)')
    np.testing.assert_allclose(rejected.x[:2], scan.seconds(scan.rates.stamps_ns)[[40, 41]])
    assert 'rejected 2 of 250' in plot.caption


def test_drift_rises_until_the_loop_closes(scan):
    curve = drift_plot(scan, None).figure.data[0]
    assert curve.y[0] == pytest.approx(0.0, abs=1e-6)
    closed = float(scan.seconds(np.array([scan.first_closure.to_stamp_ns]))[0])
    assert 0.01 < curve.y[np.searchsorted(curve.x, closed)] < 2.0
    assert drift_plot(dataclasses.replace(scan, summary=scan.summary | {'result': 'no_model'}), None) is None


def test_closing_row_is_that_of_the_first_accepted_closure(scan):
    stamps = scan.matrices.stamps_ns.tolist()
    assert stamps[closing_row(scan, scan.matrices)] == scan.first_closure.to_stamp_ns
    tried = [
        ClosureRecord(stamps[0], stamps[5], 0.3, False, ''),
        ClosureRecord(stamps[0], stamps[9], 0.6, False, ''),
    ]
    assert closing_row(dataclasses.replace(scan, closures=tried), scan.matrices) == 9
    assert closing_row(dataclasses.replace(scan, closures=[]), scan.matrices) == len(stamps) - 1


def test_a_page_of_200_key_frames_is_small_before_the_model(scan):
    n = 200
    similar = np.random.default_rng(0).random((n, n)).astype(np.float32)
    similar = np.maximum(similar, similar.T)
    stamps = scan.matrices.stamps_ns[0] + np.arange(n) * 10**8
    many = ClosureMatrices(stamps, dict.fromkeys(MEASURES, similar))
    page = render(dataclasses.replace(scan, matrices=many, surface=None))
    assert len(page.encode()) < 2.5e6
    source = page.split('<script type="application/json" data-for="pairs">')[1].split('</script>')[0]
    joint = next(t for t in json.loads(source)['data'] if t['type'] == 'heatmap')
    found = np.frombuffer(base64.b64decode(joint['meta']['half']), np.uint8)
    np.testing.assert_allclose(found / joint['meta']['steps'], similar[np.tril_indices(n)], atol=0.0021)


def test_similarity_shows_the_row_and_all_pairs(scan):
    likeness, pairs, *others = similarity_plots(scan, None)
    row = closing_row(scan, scan.matrices)
    np.testing.assert_array_equal(trace(likeness, 'joint P').y, scan.matrices.by_measure['joint'][row])
    np.testing.assert_array_equal(trace(pairs, 'joint P').z, scan.matrices.by_measure['joint'])
    shown = [t.name for t in pairs.figure.data if t.type == 'heatmap' and t.visible]
    assert shown == ['joint P']
    assert [pairs.figure.data[c.visible[0]].name for c in pairs.choices][:2] == [
        'joint P',
        'attitude P<sub>β</sub>',
    ]
    accepted = trace(pairs, 'accepted closure')
    stamps = scan.matrices.stamps_ns.tolist()
    c = scan.first_closure
    assert (accepted.x[0], accepted.y[0]) == (stamps.index(c.from_stamp_ns), stamps.index(c.to_stamp_ns))
    assert 'spread' in [p.key for p in others]


def test_spiral_winds_once_a_turn():
    xy = spiral(np.array([0.0, np.pi / 2, 2 * np.pi]))
    np.testing.assert_allclose(xy[0], [0, 1], atol=1e-12)
    assert xy[1, 0] > 1 and xy[1, 1] == pytest.approx(0, abs=1e-12)
    assert xy[2, 0] == pytest.approx(0, abs=1e-12) and xy[2, 1] > 1.2


def test_pruned_graph_leaves_out_what_is_on_no_cycle(scan):
    stamps = scan.keyframes.stamps_ns.tolist()
    closures = [
        ClosureRecord(stamps[3], stamps[30], 0.9, True, ''),
        ClosureRecord(stamps[1], stamps[20], 0.5, False, ''),
    ]
    changed = dataclasses.replace(scan, closures=closures)
    before, after = graph_plots(changed)
    xy = spiral(scan.keyframes.path_rad)
    np.testing.assert_allclose(trace(before, 'accepted (1)').x[:2], xy[[3, 30], 0])
    np.testing.assert_allclose(trace(before, 'refused (1)').y[:2], xy[[1, 20], 1])
    nodes = after.figure.data[-1]
    filled = [colour == nodes.marker.line.color for colour in nodes.marker.color]
    assert filled == [3 <= k <= 30 for k in range(len(stamps))]
    assert f'28 stay and {len(stamps) - 28} hang loose' in after.caption
    assert len(frame_graph(changed).prune()) == 28
    none = graph_plots(dataclasses.replace(scan, closures=closures[1:]))[1]
    assert 'nothing to relax' in none.caption


def test_track_goes_round_the_target(scan):
    plot = track_plot(scan)
    eye = trace(plot, 'sensor')
    away = np.linalg.norm(np.stack([eye.x, eye.y, eye.z]), axis=0)
    np.testing.assert_allclose(away, np.median(away), rtol=0.05)
    assert 700 < np.median(away) < 900
    start = transform(exp_so3([0, 0.1, 0]), np.array([0.0, 0.0, 0.5]))
    lone = dataclasses.replace(scan, surface=None, poses=[StampedPose(k, start) for k in range(3)])
    assert trace(track_plot(lone), 'target').x[0] == 0
    assert track_plot(dataclasses.replace(scan, poses=[])) is None
