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

"""The outcome of a scan in words for first-time readers: why no model, what was seen of it, of its turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from debris_scanner.core.turn import WHOLE_TURN, turn_words


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
    'camera_info': Explanation(
        'The camera_info does not fit the depth images',
        'The camera_info says how wide the camera sees. This one has no usable focal lengths, or is of '
        'images of another size, so the depth cannot be turned into points.',
        'Calibrate the camera, or record the camera_info of the depth images, not that of another resolution '
        'or of the colour camera.',
    ),
    'too_few_frames': Explanation(
        'Too few frames were usable',
        'A target was seen, but either in fewer frames than any turn takes (how two views more than 60° '
        'apart lie to each other cannot be known), or most of the frames that show it fit none before.',
        'Record for longer: at least one full turn of the target, better two. Where frames fit none before, '
        'turn the target by less from one frame to the next (20° is followed, up to 35° where it has edges), '
        'record at a higher rate, or on a faster machine. If what was cut out is not the target alone, '
        'narrow isolation.box_min and box_max to it.',
    ),
    'no_closure': Explanation(
        'No whole turn was seen',
        'The target was followed from frame to frame, but no view was recognised as one seen before, or '
        'those that were all look at one side. Without a closed turn the drift cannot be told from motion, '
        'and half of the surface would be guessed, so no model is made.',
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
    'not_rigid': Explanation(
        'The target changed while it was scanned',
        'Loops were closed, and the poses fit. But views of one side from different times disagree by more '
        'than neighbouring views do: a part moved, grew, came or went, or another object took its place. '
        'One rigid model of that would be wrong.',
        'The words of the refusal say between which times and where. Scan again while nothing moves, or give '
        'the tracker the part that stays as it is.',
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

# The target frame is the optical frame of the first key frame: x right, y down, z away from the sensor.
_SIDES = (('left side', 'right side'), ('top', 'underside'), ('front', 'back'))
SIDES_NAMED = 'Sides are those of the first key frame; directions are in the target frame.'
_HARDLY = np.radians(10)  # of a turn

_REJECTIONS = {
    'no_target': 'nothing in the box',
    'touched': 'touched by a hand, or by what else reaches in',
    'not_registered': 'did not fit the frames before',
    'degenerate_fit': 'left no finite pose',
    'error': 'ended in an error, which is logged',
    'malformed': 'could not be decoded',
    'camera_info': 'had a camera_info that cannot be theirs',
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


def coverage_words(coverage: Mapping[str, Any]) -> str:
    """One sentence on ``coverage`` of summary.json: how much was seen, and the sides that were not."""
    share, number = float(coverage['observed_share']), int(coverage['openings']['number'])
    said = f'{share_words(share)} of the closed surface was seen; {openings_words(coverage)}'
    unseen = coverage['unseen_directions']
    if unseen:
        parts = [f'of its {side(d)}, from ({", ".join(f"{x:.2f}" for x in d)})' for d in unseen]
        return f'{said}; never seen were parts {_listed(parts)}.'.replace('-', '−')
    return f'{said}, each below 1 % of the surface.' if number else f'{said}.'


def openings_words(coverage: Mapping[str, Any]) -> str:
    """The number of openings of the surface that was seen."""
    number = int(coverage['openings']['number'])
    return f'{number or "no"} opening{"" if number == 1 else "s"}'


def share_words(share: float) -> str:
    """A share as a percentage that says 100 only of all."""
    percent = 100 * share
    if percent < 99:
        return f'{percent:.0f} %'
    return '100 %' if share == 1 else f'{min(percent, 99.9):.1f} %'


def side(direction: Sequence[float]) -> str:
    """The side of the target, as the first key frame showed it, that faces a direction (3,), target frame."""
    axis = int(np.argmax(np.abs(direction)))
    return _SIDES[axis][int(direction[axis] > 0)]


def turn_explained(reason: str | None, shown: float | None) -> str:
    """What the turn that was shown, radians, means for a scan that ended without a closure; may be empty."""
    if shown is None or reason not in ('no_closure', 'interrupted'):
        return ''
    if shown >= WHOLE_TURN:
        return f'The target turned by {np.degrees(shown):.0f}° while it was followed: more than a whole turn.'
    words = turn_words(shown)
    hardly = ' It hardly turned at all.' if shown < _HARDLY else ''
    return f'{words[:1].upper()}{words[1:]}.{hardly}'


def _listed(parts: Sequence[str]) -> str:
    return '; '.join(parts[:-1]) + ('; and ' if len(parts) > 1 else '') + parts[-1]
