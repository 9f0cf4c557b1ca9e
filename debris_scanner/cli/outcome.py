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

"""The outcome of a scan for the user: a short table and, without a model, one line with the reason."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from debris_scanner.cli.errors import DONE, NO_MODEL

# Texts for the reasons in summary.json.
REASONS = {
    'no_target': 'no target was seen',
    'too_few_frames': 'too few frames were usable',
    'no_closure': 'the same face never came round again',
    'inconsistent_model': 'the views contradict each other',
    'unobservable_rotation': 'the rotation of this target cannot be observed',
    'no_match': 'the target is not the given model, or its attitude does not show',
    'no_overlap': 'the scans do not show the same surface of the same object',
    'ambiguous': 'the scans fit each other in several ways',
    'interrupted': 'the scan was interrupted before a model was found',
}


def report_outcome(directory: Path, verb: str, detail: str = '') -> int:
    """Print the outcome of the scan in ``directory`` and return the exit code.

    Args:
        directory: with the files of ``write_results``.
        verb: for the line on stderr.
        detail: the numbers behind the reason.
    """
    summary = json.loads((directory / 'summary.json').read_text(encoding='utf-8'))
    print(format_outcome(summary, directory))
    if summary['result'] in ('model', 'tracked'):
        return DONE
    reason = summary['reason']
    words = f'{reason}: {REASONS.get(reason, "")}{f" ({detail})" if detail else ""}'
    print(f'debris-scan {verb}: no model: {" ".join(words.split())}', file=sys.stderr)
    return NO_MODEL


def format_outcome(summary: Mapping[str, Any], directory: Path) -> str:
    """The table: verdict, frames, key frames, closures, rotation, model and the paths of the files."""
    frames, closures, model = summary['frames'], summary['closures'], summary['model']
    accepted = sum(c['accepted'] for c in closures)
    rejected = ', '.join(f'{n} {reason}' for reason, n in frames['rejected'].items())
    verdict = summary['result'] if summary['reason'] is None else f'no model: {summary["reason"]}'
    closed = ['mesh_closed.ply', 'mesh.glb'] if summary['coverage'] else []
    rows = [
        ('result', verdict),
        ('frames', f'{frames["used"]} of {frames["read"]} used{f" ({rejected})" if rejected else ""}'),
        ('key frames', str(summary['keyframes'])),
        ('closures', f'{accepted} of {len(closures)} accepted'),
        ('rotation period', _period(summary['rotation_period_s'])),
        ('model', f'{model["points"]} points, {model["triangles"]} triangles' if model else '-'),
        ('coverage', _coverage(summary['coverage'])),
        ('time', f'{summary["wall_s"]:.1f} s, {summary["peak_rss_mb"]:.0f} MB'),
    ]
    names = ['model.ply', 'mesh.ply', *closed, 'target_pose.tum'] if model else ['target_pose.tum']
    rows += [('files' if k == 0 else '', str(directory / n)) for k, n in enumerate([*names, 'summary.json'])]
    return '\n'.join(f'{title:18s}{text}' for title, text in rows)


def _coverage(coverage: Mapping[str, Any] | None) -> str:
    if coverage is None:
        return '-'
    number = coverage['openings']['number']
    openings = f'{number} opening{"" if number == 1 else "s"}' if number else 'no openings'
    return f'{100 * coverage["observed_share"]:.0f} % of the closed surface seen, {openings}'


def _period(seconds: float | None) -> str:
    return '-' if seconds is None else f'{seconds:.2f} s'
