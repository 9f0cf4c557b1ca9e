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

"""What became of a case, and what must hold, told from records."""

from dataclasses import replace

import pytest

from benchmarks.scorecard.acceptance_criteria import acceptance_criteria, acceptance_table
from benchmarks.scorecard.cases import all_cases
from benchmarks.scorecard.document import scorecard, summary
from benchmarks.scorecard.outcome import (
    ERROR,
    FALSE_REFUSAL,
    FALSE_REJECT,
    RIGHT,
    WRONG_MODEL,
    WRONG_REASON,
    score,
)
from benchmarks.scorecard.tables import failure_table, group_table

CASES = {c.name: c for c in all_cases()}


def record(reason=None, verdict='right', rmse=0.2, attitude=0.1, completeness=0.99, **more):
    published = reason is None
    return {
        'scan': {'reason': reason, 'why': 'its numbers', 'frames': {'used': 9, 'read': 10, 'rejected': {}}},
        'metrics': {
            'attitude_deg': {'median': attitude, 'p95': attitude, 'max': 2 * attitude},
            'position_mm': {'median': 0.3, 'p95': 0.4, 'max': 0.5},
            'model_mm': {'median': 0.1, 'rmse': rmse, 'p95': 0.4} if published else None,
            'completeness': completeness if published else None,
            'drift': {'deg': 0.5, 'mm': 0.5} if published else None,
            'verdict': verdict,
            'why': 'within | bounds',
        },
        'source': 'abc',
        **more,
    }


def with_poses(said, degrees, share):
    said['keyframe_error'] = {'attitude_deg': degrees, 'position_share': share}
    return said


def tilted(median, why='attitude', rmse=0.2, bound=None):
    """A model that is out of bounds, with so much attitude error beside the tilt of its sensor."""
    said = record(verdict='wrong', attitude=2.0, rmse=rmse, bound=bound and {'model_mm': {'rmse': bound}})
    said['metrics'] |= {'attitude_untilted_deg': {'median': median, 'max': 2 * median}, 'why': why}
    return said


@pytest.mark.parametrize(
    ('case', 'said', 'outcome'),
    [
        ('prism-spin-s0', record(), RIGHT),
        ('prism-spin-kinect2-s0', tilted(0.9), RIGHT),
        ('prism-spin-kinect2-s0', tilted(1.1), WRONG_MODEL),
        ('prism-spin-s0', tilted(0.9), WRONG_MODEL),  # it has no pattern that tilts
        ('prism-spin-kinect2-s0', tilted(0.9, 'model rmse', 2.5, 2.0), RIGHT),
        ('prism-spin-kinect2-s0', tilted(0.9, 'model rmse', 3.1, 2.0), WRONG_MODEL),
        ('prism-spin-kinect2-s0', tilted(0.9, 'model rmse', 2.5), WRONG_MODEL),
        ('prism-spin-s0', record(verdict='wrong'), WRONG_MODEL),
        ('prism-spin-s0', record('no_closure', 'wrong'), FALSE_REJECT),
        ('prism-spin-s0', record('inconsistent_model', 'right'), FALSE_REJECT),
        ('prism-spin-s0', with_poses(record('no_closure', 'wrong'), 0.9, 0.009), FALSE_REFUSAL),
        ('prism-spin-s0', with_poses(record('no_closure', 'wrong'), 1.1, 0.009), FALSE_REJECT),
        ('prism-spin-s0', with_poses(record('no_closure', 'wrong'), 0.9, 0.011), FALSE_REJECT),
        ('prism-gaps-s0', record('no_closure', 'right'), RIGHT),  # the truth says that no turn was seen
        ('prism-spin-s0', {'error': 'Traceback\nValueError: no'}, ERROR),
        ('cylinder-spin-s0', record('unobservable_rotation'), RIGHT),
        ('cylinder-spin-s0', record('no_closure'), WRONG_REASON),
        ('cylinder-spin-s0', record(), WRONG_MODEL),
        ('tank-spin-s0', record('unobservable_rotation', 'wrong'), RIGHT),
        ('tank-spin-s0', record(), RIGHT),
        ('shuttle_stack-still-s0', record('no_closure'), RIGHT),
        ('shuttle_stack-still-s0', record(), WRONG_MODEL),
        ('empty-still-s0', record('no_target'), RIGHT),
    ],
)
def test_outcomes(case, said, outcome):
    assert score(CASES[case], said).outcome == outcome


def lines(*scored):
    return {(line.case, line.what): line for line in acceptance_criteria(scored)}


def test_a_false_reject_is_not_right_and_a_wrong_model_is_counted():
    held = lines(
        score(CASES['prism-spin-s0'], record()),
        score(CASES['prism-spin-s1'], record('no_closure', 'wrong')),
        score(CASES['prism-spin-s2'], record(verdict='wrong')),
    )
    assert held['verdicts', 'right'].reached.startswith('33.3%')
    assert held['verdicts', 'right'].holds is False
    assert held['verdicts', 'wrong models published'].reached == '1'


def test_figures_are_bounded_by_class_and_motion():
    held = lines(
        score(CASES['asteroid-spin-s0'], record(rmse=0.4, bound={'model_mm': {'rmse': 0.15}})),
        score(CASES['asteroid-tumble-s0'], record(rmse=0.4)),
        score(CASES['prism-spin-s0'], record(rmse=0.7, attitude=0.2)),
        score(CASES['cubesat-spin-mli-s0'], record(rmse=1.2, attitude=0.5)),
    )
    spins = held['curved and irregular', 'model RMSE in spins, mm']
    assert (spins.holds, spins.possible) == (False, '0.15')
    assert held['curved and irregular', 'model RMSE in tumbles, mm'].holds is True
    assert held['flat-faced and thin', 'attitude median, deg'].holds is True
    assert held['near-axisymmetric', 'attitude max, deg'].holds is None
    assert held['shiny insulation', 'model RMSE, mm'].holds is True
    assert held['shiny insulation', 'modelled'].holds is True


def test_gaps_are_counted_seed_by_seed():
    names = (
        'shuttle_stack',
        'tank_boosters',
        'asteroid',
        'prism',
        'cubesat',
        'defunct_satellite',
        'upper_stage',
    )
    rows = [score(CASES[f'{n}-gaps-s{s}'], record()) for n in names for s in (0, 1)]
    assert lines(*rows)['tumble with gaps', 'modelled, seed by seed'].holds is True
    rows[0] = score(rows[0].case, record('no_closure', 'wrong'))
    held = lines(*rows)['tumble with gaps', 'modelled, seed by seed']
    assert (held.holds, held.reached) == (True, '6 of 7, 7 of 7')
    rows[2] = score(rows[2].case, record('no_closure', 'wrong'))
    assert lines(*rows)['tumble with gaps', 'modelled, seed by seed'].holds is False


def test_tracking_is_bounded():
    tracking = {'attitude_rms_deg': 0.1, 'position_rms_mm': 2.0, 'lost': 0, 'wrong': 0, 'never_reacquired': 1,
                'reacquired_s': 0.4}  # fmt: skip
    held = lines(
        score(CASES['asteroid-tracking_gaps-s0'], record(tracking=tracking)),
        score(CASES['prism-tracking-s0'], record('no_closure', 'wrong', tracking=None)),
    )
    name = 'tracking a tumble'
    assert held[name, 'tracked at all'].reached == '1 of 2'
    assert held[name, 'attitude rms, deg'].holds is True
    assert held[name, 'position rms, mm'].holds is False
    assert held[name, 'gaps after which it was not found again'].holds is False
    assert held[name, 'longest re-acquisition after a gap, s'].holds is True


def test_tables_are_markdown_with_every_failure_and_the_held_out_cases_apart():
    rows = [
        score(CASES['prism-spin-s0'], record()),
        score(CASES['prism-gaps-s0'], record('no_closure', 'wrong')),
        score(CASES['asteroid-spin-s0'], {'error': 'Traceback\nValueError: no'}),
        score(CASES['juno-spin-s0'], record(verdict='wrong', rmse=3.0)),
    ]
    classes = group_table(rows).splitlines()
    assert {line.count('|') for line in classes} == {11}
    assert '| flat-faced and thin | 1/3 |' in classes[2] and '| curved and irregular | 0/1 |' in classes[3]
    failures = failure_table(rows).splitlines()[2:]
    assert [line.split('|')[2].strip() for line in failures] == [ERROR, WRONG_MODEL, FALSE_REJECT]
    text = scorecard(rows, 'the command')
    developed, _, held_out = text.partition('## Held out')
    assert 'juno' not in developed and 'juno' in held_out and 'ValueError: no' in developed
    assert developed.startswith('`the command`, sources ')
    assert '4 cases: 1 right, 1 false reject, 1 wrong model, 1 error' in summary(rows)


def test_criteria_without_a_case_are_named_below_their_table():
    table, _, absent = acceptance_table([score(CASES['prism-spin-s0'], record())]).partition('Without')
    assert '| flat-faced and thin | model RMSE in spins, mm | 0.20 / 0.20' in table
    assert '| yes |' in table and 'near-axisymmetric' not in table and 'no case' not in table
    assert 'near-axisymmetric; ' in absent and 'verdicts' not in absent


def test_an_unknown_reason_is_never_right():
    case = replace(CASES['empty-still-s0'], reasons=('no_target',))
    assert score(case, record('interrupted')).outcome == WRONG_REASON
