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

"""The outcome of a scan in words, from its summary: for the terminal and the live view."""

from collections.abc import Mapping
from typing import Any

# Texts for the reasons in summary.json.
REASONS = {
    'no_target': 'no target was seen',
    'camera_info': 'the camera_info cannot be that of the depth images: calibrate the camera, or give theirs',
    'too_few_frames': 'too few frames were usable',
    'no_closure': 'no whole turn was seen',
    'inconsistent_model': 'the views contradict each other',
    'not_rigid': 'the target changed while it was scanned',
    'unobservable_rotation': 'the rotation of this target cannot be observed',
    'no_match': 'the target is not the given model, or its attitude does not show',
    'no_overlap': 'the scans do not show the same surface of the same object',
    'ambiguous': 'the scans fit each other in several ways',
    'error': 'every attempt at a model ended in an error, which is logged',
    'interrupted': 'the scan was interrupted before a model was found',
}


LOST_IN_TRANSPORT = 'lost_in_transport'  # key of frames that were published and never arrived
MOST_LOST = 0.03  # of the messages of a topic: above, a user is told
_FEWEST = 30  # messages that such a share is told of


def loss_words(lost: int, sent: int, of: str) -> str:
    """What was lost in transport, in words; empty up to a share that does no harm.

    Args:
        lost: of the messages sent.
        sent: lost or received.
        of: what they are.
    """
    if sent < _FEWEST or lost <= max(1, MOST_LOST * sent):  # a single one is no share
        return ''
    return f'lost in transport: {lost} of {sent} {of} ({100 * lost / sent:.0f} %)'


def outcome_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Title and text of each row: verdict, frames, key frames, closures, rotation, model, coverage, time."""
    frames, closures, model = summary['frames'], summary['closures'], summary['model']
    accepted = sum(c['accepted'] for c in closures)
    rejected = ', '.join(f'{n} {reason}' for reason, n in frames['rejected'].items())
    verdict = summary['result'] if summary['reason'] is None else f'no model: {summary["reason"]}'
    of_frames = [
        ('frames', f'{frames["used"]} of {frames["read"]} used{f" ({rejected})" if rejected else ""}'),
        ('key frames', str(summary['keyframes'])),
        ('closures', f'{accepted} of {len(closures)} accepted'),
        ('rotation period', _period(summary['rotation_period_s'])),
    ]
    if 'merged' in summary:
        of_frames = [('scans placed', str(len(summary['merged'])))]  # the first of a refused merge
    return [
        ('result', verdict),
        *([('hint', summary['hint'])] if summary.get('hint') else []),
        *of_frames,
        ('model', f'{model["points"]} points, {model["triangles"]} triangles' if model else '-'),
        ('coverage', _coverage(summary['coverage'])),
        *_beside(summary.get('model_disagreement')),
        ('time', f'{summary["wall_s"]:.1f} s, {summary["peak_rss_mb"]:.0f} MB'),
    ]


def _coverage(coverage: Mapping[str, Any] | None) -> str:
    if coverage is None:
        return '-'
    number = coverage['openings']['number']
    openings = f'{number} opening{"" if number == 1 else "s"}' if number else 'no openings'
    return f'{100 * coverage["observed_share"]:.0f} % of the closed surface seen, {openings}'


def _beside(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    if found is None:
        return []
    allowed = f'{found["deviations"]:.1f} of {found["allowed_deviations"]:.1f} standard deviations'
    return [('beside the model', f'the surface lies at most {1e3 * abs(found["by_m"]):.1f} mm, {allowed}')]


def _period(seconds: float | None) -> str:
    return '-' if seconds is None else f'{seconds:.2f} s'
