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
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from debris_scanner.cli.errors import BAD_INPUT, DONE, NO_MODEL
from debris_scanner.core.results import CAMERA_INFO
from debris_scanner.io.outcome import LOST_IN_TRANSPORT, REASONS, loss_words, outcome_rows
from debris_scanner.io.result_files import left_alone


def report_outcome(asked: Path, directory: Path, verb: str, detail: str = '') -> int:
    """Print the outcome of the scan in ``directory`` and return the exit code: bad input, too.

    Args:
        asked: output folder that was given.
        directory: with the files, as ``write_results`` returns it.
        verb: for the line on stderr.
        detail: the numbers behind the reason.
    """
    summary = json.loads((directory / 'summary.json').read_text(encoding='utf-8'))
    print(format_outcome(summary, directory))
    print(f'Next: debris-scan report {shlex.quote(str(directory))}')
    frames = summary['frames']
    if lost := loss_words(frames['rejected'].get(LOST_IN_TRANSPORT, 0), frames['read'], 'frames'):
        print(f'debris-scan {verb}: warning: {lost}', file=sys.stderr)
    if remark := left_alone(asked, directory):
        print(f'debris-scan {verb}: {remark}: this scan is in {directory}', file=sys.stderr)
    if summary['result'] in ('model', 'tracked'):
        return DONE
    reason = summary['reason']
    detail = '; '.join(text for text in (detail, summary.get('hint')) if text)
    words = f'{reason}: {REASONS.get(reason, "")}{f" ({detail})" if detail else ""}'
    print(f'debris-scan {verb}: no model: {" ".join(words.split())}', file=sys.stderr)
    return BAD_INPUT if reason == CAMERA_INFO else NO_MODEL


def format_outcome(summary: Mapping[str, Any], directory: Path) -> str:
    """The table: verdict, what was read, model, coverage, and the paths of the files."""
    closed = ['mesh_closed.ply', 'mesh.glb'] if summary['coverage'] else []
    rows = outcome_rows(summary)
    names = ['model.ply', 'mesh.ply', *closed] if summary['model'] else []
    names += [] if 'merged' in summary else ['target_pose.tum']
    rows += [('files' if k == 0 else '', str(directory / n)) for k, n in enumerate([*names, 'summary.json'])]
    return '\n'.join(f'{title:18s}{text}' for title, text in rows)
