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

"""Closure hypotheses as plain values: the entries of ``closures`` in summary.json, and the journal's."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from debris_scanner.core.geometry import from_pose_vector, to_pose_vector
from debris_scanner.core.results import Check, Checks, ClosureRecord


def closure_values(record: ClosureRecord) -> dict[str, Any]:
    """What JSON holds of a hypothesis; ``T_from_to`` as x, y, z, qx, qy, qz, qw."""
    T = record.T_from_to
    return {
        'from_stamp_ns': record.from_stamp_ns,
        'to_stamp_ns': record.to_stamp_ns,
        'T_from_to': None if T is None else to_pose_vector(T).tolist(),
        'probability': record.probability,
        'accepted': record.accepted,
        'why': record.why,
        'checks': [check._asdict() for check in record.checks],
    }


def read_closure_values(values: Mapping[str, Any]) -> ClosureRecord:
    """The inverse of :func:`closure_values`; a file may lack ``T_from_to`` and ``checks``.

    Raises:
        KeyError, TypeError, ValueError: a value is missing or malformed.
    """
    pose, probability = values.get('T_from_to'), values['probability']
    return ClosureRecord(
        int(values['from_stamp_ns']),
        int(values['to_stamp_ns']),
        float('nan') if probability is None else float(probability),
        bool(values['accepted']),
        str(values['why']),
        None if pose is None else from_pose_vector(np.array(pose, np.float64)),
        read_checks(values.get('checks', ())),
    )


def read_checks(values: Iterable[Mapping[str, Any]]) -> Checks:
    """Checks as JSON holds them: null is what is no number.

    Raises:
        KeyError, TypeError, ValueError: a value is missing or malformed.
    """
    return tuple(
        Check(
            str(c['name']),
            math.nan if c['value'] is None else float(c['value']),
            None if c['bound'] is None else float(c['bound']),
            bool(c['passed']),
        )
        for c in values
    )
