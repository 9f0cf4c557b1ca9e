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

"""The outcome of a case: right, a false reject, a wrong reason, a wrong model, or an error."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.scorecard.cases import Case
from debris_scanner.core.results import NO_CLOSURE, NO_TARGET, TOO_FEW_FRAMES
from debris_scanner.evaluation.metrics import MAX_ATTITUDE_DEG, MAX_ATTITUDE_MEDIAN_DEG
from debris_scanner.evaluation.metrics import RIGHT as EVALUATED_RIGHT

RIGHT = 'right'
WRONG_MODEL = 'wrong model'  # published, but out of bounds or of a target that cannot be modelled
FALSE_REJECT = 'false reject'  # refused, though a model was possible, after a pose went wrong
FALSE_REFUSAL = 'false refusal'  # refused, though every pose of a key frame was right
WRONG_REASON = 'wrong reason'  # rightly refused, with a wrong reason
ERROR = 'error'
OUTCOMES = (RIGHT, FALSE_REJECT, FALSE_REFUSAL, WRONG_REASON, WRONG_MODEL, ERROR)

POSE_RIGHT_DEG, POSE_RIGHT_SHARE = 1.0, 0.01  # of the target's size: a pose this near is right

OF_POSSIBLE = 1.5  # the model's error with estimated poses, of that with true ones

_SEEN_TOO_LITTLE = (NO_CLOSURE, TOO_FEW_FRAMES, NO_TARGET)


@dataclass(frozen=True)
class Scored:
    """A case with its record and its outcome."""

    case: Case
    record: Mapping[str, Any]
    outcome: str
    why: str  # one line

    def figure(self, *path: str) -> float | None:
        """A number of the record by its keys, None where it does not apply."""
        value: Any = self.record
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        return None if value is None else float(value)

    @property
    def published(self) -> bool:
        """Whether there is a model, right or wrong."""
        return 'scan' in self.record and self.record['scan']['reason'] is None

    @property
    def modelled(self) -> bool:
        """Whether a model was published and is right."""
        return self.outcome == RIGHT and self.published


def score(case: Case, record: Mapping[str, Any]) -> Scored:
    """Judge the record of a case."""
    outcome, why = _judge(case, record)
    return Scored(case, record, outcome, why)


def _judge(case: Case, record: Mapping[str, Any]) -> tuple[str, str]:
    if 'error' in record:
        line = str(record['error']).strip().splitlines()[-1]
        return (RIGHT if case.says and case.says in line else ERROR), line
    reason, metrics = record['scan']['reason'], record['metrics']
    if reason is None:
        if not case.may_be_modelled:
            return WRONG_MODEL, f'a model where {" or ".join(case.reasons)} is right'
        if metrics is None:
            return RIGHT, 'a model, as a person expects; no truth'
        right = metrics['verdict'] == EVALUATED_RIGHT
        if not right and case.options.get('sensor') and _as_the_sensor_allows(record):
            return RIGHT, f'{metrics["why"]}: as far as its sensor allows'
        return (RIGHT if right else WRONG_MODEL), metrics['why']
    said = f'{reason}: {record["scan"]["why"]}'
    if reason in case.reasons:
        hint = record['scan'].get('hint', '')
        return (RIGHT if case.says in hint else WRONG_REASON), f'{said} ({hint})' if hint else said
    if not case.may_be_modelled:
        return WRONG_REASON, f'{said} (right: {" or ".join(case.reasons)})'
    # by the truth not even one revolution came into sight
    if metrics is not None and metrics['verdict'] == EVALUATED_RIGHT and reason in _SEEN_TOO_LITTLE:
        return RIGHT, said
    return (FALSE_REFUSAL if _poses_right(record) else FALSE_REJECT), said


def _as_the_sensor_allows(record: Mapping[str, Any]) -> bool:
    """Whether attitude and model are out of bounds only by what the sensor itself does.

    A smooth pattern that is fixed in its image tilts the scene in the sensor's frame, in all frames alike; a
    turning target looks the same with and without. A model may be as far off as one made with true poses, and
    the attitude as far as that of single frames registered to it.
    """
    metrics = record['metrics']
    rest, model = metrics.get('attitude_untilted_deg'), metrics['model_mm']
    if rest is None or model is None:
        return False
    bound = record.get('bound') or {}
    possible, attitude = bound.get('model_mm'), bound.get('attitude_deg') or {'median': 0.0}
    modelled = 'model' not in metrics['why'] or (
        possible is not None and model['rmse'] <= OF_POSSIBLE * possible['rmse']
    )
    median = max(MAX_ATTITUDE_MEDIAN_DEG, attitude['median'])
    return modelled and rest['median'] <= median and rest['max'] <= MAX_ATTITUDE_DEG


def _poses_right(record: Mapping[str, Any]) -> bool:
    error = record.get('keyframe_error')
    return (
        error is not None
        and error['attitude_deg'] <= POSE_RIGHT_DEG
        and error['position_share'] <= POSE_RIGHT_SHARE
    )
