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

"""Where the time went, stage by stage."""

from collections.abc import Mapping

import numpy as np

from debris_scanner.report.style import BLUE, ORANGE, Plot, figure


def timing_plot(timing: Mapping[str, Mapping[str, float]]) -> Plot | None:
    """Median and 99th percentile of every stage that ran, the costliest on top."""
    stages = sorted(timing, key=lambda s: timing[s]['count'] * timing[s]['p50_ms'])
    if not stages:
        return None
    names = [s.replace('_', ' ') for s in stages]
    counts = np.array([timing[s]['count'] for s in stages])
    fig = figure(hovermode='closest')
    for key, title, colour, symbol in (
        ('p50_ms', 'median', BLUE, 'circle'),
        ('p99_ms', '99 %', ORANGE, 'diamond'),
    ):
        fig.add_scatter(
            x=[max(timing[s][key], 1e-3) for s in stages],
            y=names,
            mode='markers',
            name=title,
            marker={'color': colour, 'size': 10, 'symbol': symbol},
            customdata=counts,
            hovertemplate=f'%{{y}}: {title} %{{x:.3~f}} ms, %{{customdata}} times<extra></extra>',
        )
    for name, s in zip(names, stages, strict=True):
        fig.add_shape(
            type='line',
            x0=max(timing[s]['p50_ms'], 1e-3),
            x1=max(timing[s]['p99_ms'], 1e-3),
            y0=name,
            y1=name,
            line={'color': 'var(--line)', 'width': 4},
            layer='below',
        )
    fig.update_xaxes(type='log', title={'text': 'milliseconds a call'}, dtick=1)
    return Plot(
        'timing',
        'Time per stage',
        fig,
        'How long each stage took, a point for the usual case and one for the slowest in a hundred; the '
        'costliest in all, by count and median, on top. <b>Look for</b> the stages that run at every frame '
        '(isolate, normals, view, registration or tracking): their sum must stay below the time between two '
        'frames for a live scan to keep pace. Generation, with relaxation, refinement and fusion inside it, '
        'runs only when a model is made.',
        max(260, 60 + 26 * len(stages)),
    )
