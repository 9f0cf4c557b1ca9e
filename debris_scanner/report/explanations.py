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

"""The outcome of a scan in words for first-time readers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Explanation:
    """Why a scan has no model, and what can be done."""

    headline: str
    meaning: str
    advice: str


_REASONS = {
    'no_target': Explanation(
        'No target was seen',
        'In none of the frames did anything stand in the box in front of the sensor where a target is '
        'looked for.',
        'Check that the target lies within the box (by default 20 m to all sides), '
        'that the depth unit is right, and that the recording holds the topic you meant.',
    ),
    'too_few_frames': Explanation(
        'Too few frames were usable',
        'A target was seen, but in fewer frames than a scan needs before anything can be said.',
        'Record for longer: at least one full turn of the target, better two.',
    ),
    'no_closure': Explanation(
        'The same face never came round again',
        'The target was followed from frame to frame, but no view was recognised as one seen before. '
        'Without that the drift cannot be told from motion, so no model is made from an open loop.',
        'Record at least one full turn. If it was one, look at the hypotheses below: those that were tried '
        'say which number failed, and the map of pairs shows whether a face came back at all.',
    ),
    'inconsistent_model': Explanation(
        'The views contradict each other',
        'A loop was closed, but with it the views do not fit one rigid surface: some of them would fit much '
        'better where the others do not have them. Or only looks told how the target had turned while '
        'it was out of sight, and it looks the same from several sides. A wrong model is worse than '
        'none, so none is published.',
        'Look for a look-alike face among the accepted closures, for a target that is not rigid, and for '
        'another object that moves along with it inside the box.',
    ),
    'unobservable_rotation': Explanation(
        'The rotation of this target cannot be observed',
        'The target looks the same while it turns, as a cylinder about its own axis does. No depth sensor '
        'can tell how far such a target has turned, and a model made from a guess would be arbitrary. To '
        'give none is the right answer here.',
        'Nothing is wrong with the recording. Only what breaks the symmetry can help: another axis of '
        'rotation, a view that shows an edge or an attachment, or a sensor that resolves finer detail.',
    ),
    'interrupted': Explanation(
        'The scan was interrupted before a model was found',
        'It was stopped before any loop was closed; everything up to there is below.',
        'Let it run until the target has shown the same face twice.',
    ),
}

_REJECTIONS = {
    'no_target': 'nothing in the box',
    'touched': 'touched by a hand, or by what else reaches in',
    'not_registered': 'did not fit the frames before',
    'malformed': 'could not be decoded',
    'non_monotone_stamp': 'older than the frame before',
}


def explain(reason: str | None) -> Explanation:
    """Explanation of a reason in summary.json; an unknown one is quoted."""
    unknown = Explanation(f'No model: {reason}', 'The scan ended without a model.', 'See the plots below.')
    return _REASONS.get(str(reason), unknown)


def rejected(frames: Mapping[str, Any]) -> str:
    """Counts of the frames that were not used, in words; empty if all were."""
    counts: Mapping[str, int] = frames.get('rejected') or {}
    return ', '.join(f'{n} {_REJECTIONS.get(reason, reason)}' for reason, n in counts.items())
