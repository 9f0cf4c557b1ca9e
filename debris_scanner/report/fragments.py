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

"""Pieces of HTML: the verdict, figures, tables. Everything that comes from a file is escaped."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from debris_scanner.core.geometry import rotation_angle, to_pose_vector
from debris_scanner.core.results import ClosureRecord
from debris_scanner.evaluation.closure_scores import BY_ATTITUDE
from debris_scanner.evaluation.metrics import MAX_ATTITUDE_DEG, MAX_ATTITUDE_MEDIAN_DEG, MAX_MODEL_RMSE_MM
from debris_scanner.report.explanations import (
    explain,
    openings_words,
    rejected,
    share_words,
    turn_explained,
)
from debris_scanner.report.scan_output import ScanOutput

# The checks of a closure by name: column heading and meaning.
_DECIDING = {
    'overlap': ('overlap', 'share of the points that have a match'),
    'excess_loss': (
        'excess loss',
        'how much worse than consecutive views they explain each other, nats a point',
    ),
    'asked_of_a_step': (
        'asked of a step',
        'what the correction costs each step between the two, nats a point',
    ),
    'correction_deg': ('corrected °', 'how much registration turned the estimate'),
    'loss_rank': ('rank of loss', 'share of consecutive key frames that explain each other better'),
    'lead_over_other_attitudes': (
        'lead',
        'how much worse the next best attitude explains the views, nats a point',
    ),
    'agreeing_views': ('agreeing views', 'that say the same of where the submap lies'),
    'off_motion_deg': ('off the motion °', 'from where the rates lead while the target was out of sight'),
    'out_of_sight_s': ('out of sight s', 'how long, between the two submaps'),
    'nearby_pairs': ('pairs', 'views of the two submaps from nearby'),
    'worst_pair_excess_loss': ('worst pair', 'the largest excess loss of these pairs, nats a point'),
}


def verdict(scan: ScanOutput) -> str:
    """The banner: was a model found, and why or why not."""
    s = scan.summary
    if s['result'] == 'model':
        accepted = sum(c.accepted for c in scan.closures)
        model = s.get('model') or {}
        text = (
            f'<p>The target came round to a face seen before, {_plural(accepted, "closure")} passed every '
            f'check, and the views agree on one surface: {model.get("points", 0):,} points and '
            f'{model.get("triangles", 0):,} triangles.</p>'
        )
        text += _checked(scan) + _judged(scan)
        return f'<div class="verdict good"><h2><span>✓</span> Model found</h2>{text}</div>'
    why = explain(s.get('reason'))
    tried, hint = len(scan.closures), str(s.get('hint') or '')
    hypotheses = (
        f'{_plural(tried, "hypothesis", "hypotheses")} of a closure {"was" if tried == 1 else "were"} tried'
    )
    turn = turn_explained(s.get('reason'), scan.turn_shown)
    return (
        f'<div class="verdict bad"><h2><span>–</span> No model: {escape(_lower(why.headline))}</h2>'
        f'{f"<p><b>{turn}</b></p>" if turn else ""}'
        f'<p>{escape(why.meaning)}{f" <b>{escape(hint)}.</b>" if hint else ""}</p>'
        f'<p><b>What to do.</b> {escape(why.advice)}</p>'
        f'<p class="small">Reason in summary.json: <code>{escape(str(s.get("reason")))}</code>. '
        f'{hypotheses}, {sum(c.accepted for c in scan.closures)} accepted, '
        f'among {_plural(int(s["keyframes"]), "key frame")}.</p>{_checked(scan)}{_judged(scan)}</div>'
    )


def _checked(scan: ScanOutput) -> str:
    """The checks of the verdict, each with its bound."""
    if not scan.checks:
        return ''
    said = ', '.join(f'{"✓" if check.passed else "✗"} {check.words}' for check in scan.checks)
    return f'<p class="small">Checks: {escape(said.replace("_", " "))}.</p>'


def _judged(scan: ScanOutput) -> str:
    if scan.metrics is None:
        return ''
    said, why = escape(str(scan.metrics.get('verdict'))), escape(str(scan.metrics.get('why', '')))
    return f'<p class="small">Judged by the truth, this outcome is <b>{said}</b>: {why}.</p>'


def tiles(scan: ScanOutput) -> str:
    """The main figures."""
    s = scan.summary
    frames = s['frames']
    period, axis = s.get('rotation_period_s'), s.get('rotation_axis_sensor')
    lost = rejected(frames)
    entries = [
        ('frames used', f'{frames["used"]:,}', f'of {frames["read"]:,} read{"; " + lost if lost else ""}'),
        (
            'key frames',
            f'{s["keyframes"]:,}',
            f'{sum(c.accepted for c in scan.closures)} of {len(scan.closures)} closures accepted',
        ),
        (
            'rotation period',
            '–' if period is None else f'{period:.2f} s',
            'no steady rotation'
            if axis is None
            else 'axis ' + ', '.join(f'{a:+.2f}' for a in axis) + ' (sensor)',
        ),
        ('took', f'{s["wall_s"]:.1f} s', f'{s["peak_rss_mb"]:,.0f} MB of memory at most'),
    ]
    if found := s.get('coverage'):
        entries.append(('surface seen', share_words(found['observed_share']), openings_words(found)))
    if s.get('symmetry'):
        entries.append(('symmetry', f'{s["symmetry"]}-fold', 'found in the model'))
    if sensor := s.get('sensor'):
        entries.append(
            (
                'sensor noise',
                f'{sensor["sigma_m"] * 1e3:.2f} mm',
                f'at {sensor["range_m"]:.2f} m, where a pixel covers {sensor["footprint_m"] * 1e3:.2f} mm; '
                f'correlated over {sensor["correlation_px"]:.1f} px{_bent(sensor)}',
            )
        )
    return _tiles(entries)


def _bent(sensor: Mapping[str, Any]) -> str:
    """What of the sensor's error stays in the image, if any does."""
    if not (offset := sensor.get('offset_m')):
        return ''
    return f'; all images bent by {offset * 1e3:.2f} mm, which is taken off'


def _tiles(entries: Sequence[tuple[str, str, str]]) -> str:
    cells = (
        f'<div class="tile"><div class="label">{escape(label)}</div><div class="value">{escape(value)}</div>'
        f'<div class="note">{escape(note)}</div></div>'
        for label, value, note in entries
    )
    return f'<div class="tiles">{"".join(cells)}</div>'


def figures_table(metrics: Mapping[str, Any]) -> str:
    """metrics.json: errors with their bounds as a table, the rest as tiles."""
    names = {'median': 'median', 'rmse': 'rmse', 'p95': '95 %', 'max': 'max'}
    rows = []
    published = metrics.get('model_mm') is not None  # the bounds are a model's
    for key, title, unit, bounds in (
        ('attitude_deg', 'attitude', '°', {'median': MAX_ATTITUDE_MEDIAN_DEG, 'max': MAX_ATTITUDE_DEG}),
        ('position_mm', 'position', 'mm', {}),
        ('model_mm', 'model surface', 'mm', {'rmse': MAX_MODEL_RMSE_MM}),
        ('mesh_mm', 'mesh surface', 'mm', {}),
    ):
        found = metrics.get(key) or {}
        marks = [
            f'{"✓" if found[name] <= bound else "✗"} {names[name]} ≤ {bound:g}'
            for name, bound in bounds.items()
            if published and found.get(name) is not None
        ]
        rows.append([f'{title}, {unit}', *(_number(found.get(n)) for n in names), ', '.join(marks)])
    drift, closures = metrics.get('drift') or {}, metrics.get('closures') or {}
    entries = [
        ('completeness', _percent(metrics.get('completeness')), 'of the surface seen'),
        (
            'closure precision',
            _percent(closures.get('precision')),
            f'{closures.get("false", "–")} false'
            + (', judged by attitude' if metrics.get('closures_by') == BY_ATTITUDE else ''),
        ),
        ('closure recall', _percent(closures.get('recall')), 'of the returns to a face seen before'),
    ]
    if drift:
        entries.append(('drift at the first closure', f'{drift["deg"]:.3f}°', f'{drift["mm"]:.3f} mm'))
    return table(['error of the', *names.values(), 'bounds'], rows) + _tiles(entries)


def closure_table(scan: ScanOutput) -> str:
    """All hypotheses with their numbers, sortable by any column."""
    index = {int(s): k for k, s in enumerate(scan.keyframes.stamps_ns)}
    numbers = [{check.name: check.value for check in c.checks} for c in scan.closures]
    shown = [name for name in _DECIDING if any(name in n for n in numbers)]
    rows = []
    for c, found in zip(scan.closures, numbers, strict=True):
        verdict = 'accepted' if c.accepted else 'refused'
        rows.append(
            [
                f'<span class="badge {"good" if c.accepted else "bad"}">{verdict}</span>',
                f'<span class="why" title="{escape(c.why)}">{escape(_deciding(c))}</span>',
                *(_moment(scan, index, stamp) for stamp in (c.to_stamp_ns, c.from_stamp_ns)),
                _number(c.probability),
                _turn(c),
                *(_number(found.get(n)) for n in shown),
            ]
        )
    heads = ['decision', 'why', 'key frame', 'shows that of', 'joint P', 'turned °']
    titles = [
        '',
        'the check that decided',
        'the newer key frame',
        'the earlier key frame',
        'it was tried for this',
        'rotation between the two views as registered; a tooltip has the whole T_from_to',
    ]
    heads += [_DECIDING[n][0] for n in shown]
    titles += [_DECIDING[n][1] for n in shown]
    return table(heads, rows, titles, sortable=True, raw=True)


def _deciding(closure: ClosureRecord) -> str:
    """The checks that refused a closure, in words; the rest of its record are numbers that passed."""
    if closure.accepted:
        return 'all checks passed'
    failed = ', '.join(check.words for check in closure.checks if not check.passed) or closure.why
    return failed.replace('not <=', 'not ≤').replace('not >=', 'not ≥').replace('_', ' ')


def _turn(closure: ClosureRecord) -> str:
    """Angle of the registered relative pose, which the tooltip shows whole; a dash where there is none."""
    T = closure.T_from_to
    if T is None:
        return '–'
    whole = ' '.join(f'{x:.6f}' for x in to_pose_vector(T).tolist())
    return f'<span title="T_from_to {whole}">{np.degrees(rotation_angle(T[:3, :3])):.2f}</span>'


def _moment(scan: ScanOutput, index: Mapping[int, int], stamp_ns: int) -> str:
    """Number of a key frame and its time."""
    seconds = scan.seconds(np.array([stamp_ns], dtype=np.int64))[0]
    return f'{index.get(stamp_ns, "–")} <small>{seconds:.2f} s</small>'


def timing_table(timing: Mapping[str, Mapping[str, float]]) -> str:
    """Counts and times of the stages, sortable."""
    rows = [
        [
            s.replace('_', ' '),
            f'{t["count"]:.0f}',
            f'{t["p50_ms"]:.3f}',
            f'{t["p99_ms"]:.3f}',
            f'{t["count"] * t["p50_ms"] / 1e3:.2f}',
        ]
        for s, t in timing.items()
    ]
    return table(['stage', 'times', 'median ms', '99 % ms', 'about, in all, s'], rows, sortable=True)


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    titles: Sequence[str] = (),
    sortable: bool = False,
    raw: bool = False,
) -> str:
    """An HTML table; cells are escaped unless ``raw``."""
    cells = []
    for k, head in enumerate(heads):
        title = f' title="{escape(titles[k])}"' if k < len(titles) and titles[k] else ''
        label = f'<button type="button">{escape(head)}</button>' if sortable else escape(head)
        cells.append(f'<th scope="col"{title}>{label}</th>')
    body = ''.join(
        '<tr>' + ''.join(f'<td>{cell if raw else escape(cell)}</td>' for cell in row) + '</tr>'
        for row in rows
    )
    kind = ' class="sortable"' if sortable else ''
    head = f'<thead><tr>{"".join(cells)}</tr></thead>'
    return f'<div class="scroll"><table{kind}>{head}<tbody>{body}</tbody></table></div>'


def script_json(content: Any) -> str:
    """JSON for a script element; no "<" in it can end the element early."""
    return json.dumps(content, separators=(',', ':')).replace('<', '\\u003c')


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return '–'
    return str(value) if isinstance(value, int) else f'{value:.3f}'


def _percent(share: float | None) -> str:
    return '–' if share is None else f'{100 * share:.1f} %'


def _plural(n: int, word: str, words: str = '') -> str:
    return f'{n:,} {word if n == 1 else words or word + "s"}'


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
