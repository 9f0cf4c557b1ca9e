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

"""What the state of a scan is, and what whoever turns the target should do next."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from debris_scanner.core.turn import WHOLE_TURN, turn_words

WAITING, SCANNING, GENERATING = 'waiting', 'scanning', 'generating'
TRACKING, LOST, FINISHED = 'tracking', 'lost', 'finished'
PAUSED, NO_MODEL = 'paused', 'no model'
MOST_REJECTED = 0.5  # of the last frames: above, the reason of the rejections is what matters

STEPS = {
    WAITING: 'put the target in front of the sensor, and turn it',
    GENERATING: 'turn on: a model is being made, frames go on',
    TRACKING: 'the target is tracked: turn on to fill what is open, or finish',
    LOST: 'lost: hold it where it was, it is being searched for',
    PAUSED: 'frames are dropped: resume to go on',
    FINISHED: 'the scan has ended: reset starts a new one',
}
# Rejections of frames that the user can do something about.
REMEDIES = {
    'no_target': 'no target in sight: put it in front of the sensor, farther away if it is very near',
    'touched': 'take the hand away: it touches the target',
    'settling': 'turn the target: so far nothing moves',
    'malformed': 'messages cannot be read: see the remark',
    'camera_info': 'the camera_info cannot be that of the depth: see the remark',
    'no_camera_info': 'depth comes without camera_info: start it, or remap it',
}
_OPPOSITE = (('left', 'right'), ('top', 'bottom'))


@dataclass(frozen=True)
class Situation:
    """What is known of the scan."""

    state: str = ''  # of topic state; empty before the first
    turned: float = 0.0  # radians of the turn seen
    cut: frozenset[str] = (
        frozenset()
    )  # borders of the image that the target reaches: left, right, top, bottom
    rejected: Mapping[str, int] = field(default_factory=dict)  # of the last second, by reason
    received: int = 0  # frames of the last second
    paused: bool = False
    source_ended: bool = False
    phase: str = ''  # what the end of the scan is at
    result: Mapping[str, Any] | None = None  # summary.json, once the scan has ended


@dataclass(frozen=True)
class Guide:
    """A headline and the next step."""

    state: str
    step: str


def guide(now: Situation) -> Guide:
    """State and next step in words."""
    if now.result is not None:
        return _of_result(now.result)
    if now.phase:
        return Guide(GENERATING, f'the last model is being made: {now.phase}')
    if now.paused:
        return Guide(PAUSED, STEPS[PAUSED])
    state = now.state or WAITING
    if state == FINISHED:
        return Guide(state, STEPS[FINISHED])
    if now.source_ended and state != GENERATING:
        return Guide(state, 'the recording has ended: the last model is being made')
    if state != GENERATING and (obstacle := _obstacle(now)):
        return Guide(state, obstacle)
    if state == SCANNING:
        return Guide(state, scanning_step(now.turned))
    return Guide(state, STEPS.get(state, ''))


def scanning_step(turned: float) -> str:
    """The next step of a scan without a model, after a turn of so many radians."""
    if turned < WHOLE_TURN:
        return turn_words(turned)
    return 'a whole turn seen: turn on until a face comes round again'


def _obstacle(now: Situation) -> str:
    """Why frames do not help at the moment; empty if they do."""
    reason = max(now.rejected, key=lambda r: now.rejected[r], default='')
    if reason in REMEDIES and now.rejected[reason] > MOST_REJECTED * max(now.received, 1):
        if reason == 'no_target' and now.state == LOST:
            return STEPS[LOST]
        return REMEDIES[reason]
    if any(set(pair) <= now.cut for pair in _OPPOSITE):
        return 'too near: the image does not hold all of it, move it away'
    if now.cut:
        return f'cut off at the {" and ".join(sorted(now.cut))} of the image: move it to the middle'
    return ''


def _of_result(result: Mapping[str, Any]) -> Guide:
    if result.get('result') in ('model', 'tracked'):
        done = 'the model is done' if result['result'] == 'model' else 'the known model was tracked'
        return Guide(FINISHED, f'{done}: see the report')
    return Guide(NO_MODEL, f'{result.get("reason") or "no reason given"}: the report shows why')
