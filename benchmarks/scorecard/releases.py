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

"""A scorecard a release, kept as data: what became of each case, and a picture over the versions."""

import json
import re
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scorecard.outcome import OUTCOMES, RIGHT, Scored
from debris_scanner.io.files import write_atomically

RELEASES = Path('docs/releases')
PICTURE = 'versions.svg'
FIGURES = {
    'attitude_median_deg': ('metrics', 'attitude_deg', 'median'),
    'attitude_max_deg': ('metrics', 'attitude_deg', 'max'),
    'model_rmse_mm': ('metrics', 'model_mm', 'rmse'),
    'completeness': ('metrics', 'completeness'),
}
_COLOURS = ('#3a9d5d', '#e0a13b', '#c9c04a', '#8d8d8d', '#c8433a', '#30303a')  # of OUTCOMES
_DIGITS = 4
_LABELLED = 0.03  # share of the cases, from which on a number fits into its bar


def write_release(folder: Path, version: str, command: str, rows: Sequence[Scored]) -> Path:
    """Write VERSION.json: the cases by name, with their outcomes and the figures of their models.

    Args:
        folder: of all releases.
        version: as 1.2.3.
        command: that made the results.
        rows: the cases.

    Returns:
        The file.

    Raises:
        ValueError: the cases are of several sources.
    """
    sources = sorted({str(r.record.get('source')) for r in rows})
    if len(sources) != 1:
        raise ValueError(f'results of sources {", ".join(sources)}: a release has one; run with --fresh')
    cases = {r.case.name: {'outcome': r.outcome, **_figures(r)} for r in rows}
    content = {'version': version, 'command': command, 'source': sources[0], 'cases': cases}
    head = json.dumps(content | {'cases': None}, indent=1).replace('"cases": null', '"cases": {')
    lines = ',\n'.join(f'  {json.dumps(name)}: {json.dumps(figures)}' for name, figures in cases.items())
    path = folder / f'{version}.json'
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, f'{head.removesuffix("}").rstrip()}\n{lines}\n }}\n}}\n'.encode())
    return path


def _figures(row: Scored) -> dict[str, float]:
    if not row.published:
        return {}
    found = {name: row.figure(*path) for name, path in FIGURES.items()}
    return {name: round(value, _DIGITS) for name, value in found.items() if value is not None}


def read_releases(folder: Path) -> list[dict[str, Any]]:
    """All releases in the order of their versions."""
    found = [json.loads(path.read_text(encoding='utf-8')) for path in folder.glob('*.json')]
    return sorted(found, key=lambda release: [int(n) for n in re.findall(r'\d+', release['version'])])


def draw(folder: Path) -> Path:
    """Draw outcomes and errors of the cases that all releases have, a column a version."""
    import matplotlib

    matplotlib.use('svg')
    matplotlib.rcParams['svg.hashsalt'] = 'versions'  # the same figures give the same file
    from matplotlib import pyplot as plt

    releases = read_releases(folder)
    shared = sorted(set.intersection(*(set(release['cases']) for release in releases)))
    versions = [release['version'] for release in releases]
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.5, 3.2), layout='constrained')
    base = np.zeros(len(releases))
    for outcome, colour in zip(OUTCOMES, _COLOURS, strict=True):
        counts = [sum(r['cases'][name]['outcome'] == outcome for name in shared) for r in releases]
        if any(counts):
            left.bar(versions, counts, bottom=base, color=colour, label=outcome, width=0.6)
            for x, count in enumerate(counts):
                if count >= len(shared) * _LABELLED:
                    left.text(x, base[x] + count / 2, str(count), color='white', ha='center', va='center')
        base += counts
    left.set(title=f'{len(shared)} cases', ylabel='scans')
    figure.legend(*left.get_legend_handles_labels(), loc='outside lower left', ncols=5, fontsize='small')
    for name, label in (('attitude_median_deg', 'attitude, deg'), ('model_rmse_mm', 'model RMSE, mm')):
        values = [
            np.median(
                [c[name] for n in shared if (c := r['cases'][n])['outcome'] == RIGHT and name in c] or nan
            )
            for r in releases
        ]
        right.plot(versions, values, 'o-', label=label)
    right.set(title='medians of the right models')
    right.set_ylim(bottom=0)
    right.legend(fontsize='small')
    path = folder / PICTURE
    figure.savefig(path, metadata={'Date': None})
    plt.close(figure)
    return path
