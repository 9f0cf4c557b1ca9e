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

"""The matrix: which target in which motion, under which sensor condition, with which seed.

Not the full product. Ten motions of every target at 10 Hz with three seeds are the body of it; other frame
rates, correlated noise, shiny insulation, clutter, tracking and what cannot be modelled come on top.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from benchmarks.real_recordings import REAL
from benchmarks.scorecard.targets import STRANGER, TARGETS, UNOBSERVABLE, ScoredTarget
from benchmarks.strangers import STRANGERS, recording
from debris_scanner.core.results import INCONSISTENT_MODEL, NO_CLOSURE, NO_TARGET, UNOBSERVABLE_ROTATION
from debris_scanner.sim.clutter import STOOD_ON
from debris_scanner.sim.motions import (
    CLOHESSY_WILTSHIRE,
    DECAYING_SPIN,
    SPIN,
    STEPS,
    STILL,
    STOPS,
    SWING,
    TUMBLE,
)
from debris_scanner.sim.sensors import KINECT1, SENSORS

BOUND, SIMILARITY = 'bound', 'similarity'
EXTRAS = (BOUND, SIMILARITY)  # what may be found out about a case besides

SEEDS = (0, 1, 2)
HELD_OUT_SEEDS = (7, 8, 9)  # of targets that were developed on: the seed turns axis, phase and gaps too

# Options of the simulator by the name of the motion; long enough for more than a turn.
MOTIONS: dict[str, dict[str, Any]] = {
    'spin': {'motion': SPIN, 'seconds': 25.0},
    'slow_spin': {'motion': SPIN, 'spin_rad_s': 0.2, 'seconds': 45.0},
    'fast_spin': {'motion': SPIN, 'spin_rad_s': 0.8, 'seconds': 20.0},
    'reversed_spin': {'motion': SPIN, 'spin_rad_s': -0.5, 'seconds': 25.0},
    # 42 degrees off the vertical, a part of it towards the sensor
    'tilted_spin': {'motion': SPIN, 'axis_sensor': (0.55, -0.75, -0.37), 'seconds': 25.0},
    'decaying_spin': {'motion': DECAYING_SPIN, 'seconds': 30.0},
    'swing': {'motion': SWING, 'seconds': 25.0},
    'clohessy_wiltshire': {'motion': CLOHESSY_WILTSHIRE, 'seconds': 25.0},
    'tumble': {'motion': TUMBLE, 'seconds': 60.0},
    'gaps': {'motion': TUMBLE, 'seconds': 60.0, 'gaps': True},
    # the model comes in the first 40 s or so; 60 s and more are left to track it
    'tracking': {'motion': TUMBLE, 'seconds': 110.0},
    'tracking_gaps': {'motion': TUMBLE, 'seconds': 110.0, 'gaps': True, 'gaps_from_s': 45.0},
    'leaves': {'motion': SPIN, 'seconds': 15.0, 'leaves_s': 6.0},
    'still': {'motion': STILL, 'seconds': 15.0},
    # turntables: by 20 degrees a step, and with stops of ten seconds
    'steps': {'motion': STEPS, 'seconds': 28.0},
    'stops': {'motion': STOPS, 'seconds': 48.0},
}
TRACKED = ('tracking', 'tracking_gaps')
TUMBLES = ('tumble', 'gaps', *TRACKED)
TURNTABLES = ('steps', 'stops')
BODY = tuple(m for m in MOTIONS if m not in (*TRACKED, *TURNTABLES, 'leaves', 'still'))
CLUTTERED = ('shuttle_stack', 'asteroid', 'cubesat', 'upper_stage')
MLI, SOME_MLI = 'mli', 'mli40'  # over the whole surface, or 40 % of it
# Sensors by the name of the condition, each at its own range before a target of the size that suits it.
MOTIONS_OF_SENSORS = ('spin', 'tumble', 'gaps', 'swing')
REAL_LIKE = 'd415_real'  # with all that is wrong with recordings
SENSORS_CROSSED = tuple(name for name in SENSORS if name not in (KINECT1, REAL_LIKE))
SIZE_BETWEEN: dict[str, Any] = {'sensor': 'azure', 'size': 1.6, 'range_m': 3.2}
SHINY = ('shuttle_stack', 'cubesat')
ON_DESKS = ('shuttle_stack', 'prism', 'asteroid', 'cubesat', 'defunct_satellite', 'upper_stage')
OFF_AXIS: dict[str, Any] = {'centre_of_mass': (0.05, 0.0, 0.0)}  # it turns about
OFF_AXIS_TARGETS = ('shuttle_stack', 'asteroid')


@dataclass(frozen=True)
class Case:
    """One recording to scan, and what a right answer is."""

    target: ScoredTarget
    motion: str  # name in MOTIONS, or another for what stands alone
    seed: int = 0
    condition: str = ''  # of the sensor or scene, as it stands in the name; empty for the usual one
    options: dict[str, Any] = field(default_factory=dict, hash=False)  # of SimulationSettings
    may_be_modelled: bool = True
    reasons: tuple[str, ...] = ()  # for no model that are right
    says: str = ''  # words that the hint, or the line that refuses the input, must have
    held_out: bool = False

    @property
    def name(self) -> str:
        """Unique, and fit for a file's name."""
        parts = (self.target.name, self.motion, self.condition, f's{self.seed}')
        return '-'.join(p for p in parts if p)

    @property
    def key(self) -> dict[str, Any]:
        """What decides the recording: a result with another key is of another case."""
        options = {k: list(v) if isinstance(v, tuple) else v for k, v in self.options.items()}
        return {'target': self.target.name, 'size': self.target.size, 'seed': self.seed, **options}

    @property
    def frames(self) -> int:
        """About how many frames it has, to tell how far a run is."""
        return round(self.options.get('seconds', 8.0) * self.options.get('rate_hz', 10.0))


def _case(name: str, motion: str, seed: int, condition: str = '', **more: Any) -> Case:
    target = TARGETS[name]
    reasons: tuple[str, ...] = ()
    if target.kind == UNOBSERVABLE or target.may_be_unobservable:
        reasons = (UNOBSERVABLE_ROTATION,)
    if condition == MLI and target.may_be_too_shiny:
        reasons = (NO_CLOSURE, INCONSISTENT_MODEL)
    return Case(
        target,
        motion,
        seed,
        condition,
        {**MOTIONS[motion], **more},
        may_be_modelled=target.kind != UNOBSERVABLE,
        reasons=reasons,
        held_out=target.held_out or seed in HELD_OUT_SEEDS,
    )


def _impossible(
    name: str, motion: str, seed: int, reasons: tuple[str, ...], condition: str = '', **more: Any
) -> Case:
    return Case(
        TARGETS[name],
        motion,
        seed,
        condition,
        {**MOTIONS[motion], **more},
        may_be_modelled=False,
        reasons=reasons,
        held_out=TARGETS[name].held_out or seed in HELD_OUT_SEEDS,
    )


def _modelled() -> list[Case]:
    """Cases of targets that can be modelled, developed on or held out."""
    known = [t.name for t in TARGETS.values() if not t.held_out and t.kind in _OBSERVABLE]
    new = [t.name for t in TARGETS.values() if t.held_out and t.kind in _OBSERVABLE]
    cases = [_case(t, m, s) for t in (*known, *new) for m in BODY for s in SEEDS]
    for t in known:
        cases += [_case(t, m, 0, '5hz', rate_hz=5.0) for m in ('spin', 'tumble')]
        cases += [_case(t, 'spin', 0, '30hz', rate_hz=30.0)]
        cases += [_case(t, m, 0) for m in TURNTABLES]
        cases += [
            _case(t, 'spin', 0, f'{hz:g}hz', rate_hz=hz, spin_rad_s=0.17, seconds=60.0)
            for hz in (1.0, 2.0, 3.0)
        ]
        cases += [_case(t, m, s, 'correlated', correlated=True) for m in ('spin', 'tumble') for s in SEEDS]
        cases += [_case(t, m, s) for m in ('tilted_spin', 'swing', 'tumble', 'gaps') for s in HELD_OUT_SEEDS]
        cases += [_case(t, 'gaps', s, 'patchy', patchy=True) for s in SEEDS]
        cases += [_case(t, m, s) for m in TRACKED for s in (SEEDS if TARGETS[t].mesh is None else SEEDS[:1])]
        cases += [
            _case(t, m, s, sensor, sensor=sensor, size=None)
            for sensor in SENSORS_CROSSED
            for m in MOTIONS_OF_SENSORS
            for s in SEEDS
            if not TARGETS[t].may_be_unobservable
        ]
        cases += [_case(t, 'spin', s, SOME_MLI, mli=True, mli_share=0.4) for s in SEEDS]
        # 0.1 and 4 m come with the sensors that see such targets
        cases += [_case(t, 'spin', s, '160cm', **SIZE_BETWEEN) for s in SEEDS]
    for t in new:
        cases += [_case(t, m, 0, x, sensor=x, size=None) for x in SENSORS_CROSSED for m in ('spin', 'tumble')]
        cases += [_case(t, 'tracking_gaps', 0)]
        cases += [_case(t, 'spin', 0, 'correlated', correlated=True)]
        cases += [_case(t, 'spin', 0, '5hz', rate_hz=5.0)]
    for t in SHINY:
        cases += [_case(t, m, s, MLI, mli=True) for m in ('spin', 'tumble') for s in SEEDS]
    for t in CLUTTERED:
        cases += [_case(t, 'spin', s, c, clutter=c) for c in ('wall', 'table', 'object') for s in SEEDS]
    for t in ON_DESKS:
        cases += [_case(t, 'spin', s, c, clutter=c) for c in STOOD_ON for s in SEEDS]
    cases += [_case(t, 'spin', s, 'off_axis', **OFF_AXIS) for t in OFF_AXIS_TARGETS for s in SEEDS]
    cases += [_case('shuttle_stack', 'swing', s, 'wall', clutter='wall') for s in SEEDS]
    cases += [_case('churyumov', 'spin', s, c, clutter=c) for c in ('wall', 'table', 'object') for s in SEEDS]
    return cases


def _strangers() -> list[Case]:
    cases = []
    for n in STRANGERS:
        motion, options = recording(n)
        cases.append(_case(f'stranger{n:02d}', motion, n, **options))
    return cases


def _not_modelled() -> list[Case]:
    """Cases without a model to be had, each with the reasons that are right."""
    cases = [
        _case('cylinder', m, s)
        for m in ('spin', 'fast_spin', 'reversed_spin', 'swing', 'clohessy_wiltshire')
        for s in SEEDS
    ]
    for s in SEEDS:
        cases += [
            _impossible(t, 'still', s, (NO_CLOSURE,))
            for t in ('shuttle_stack', 'prism', 'asteroid', 'upper_stage', 'churyumov')
        ]
        cases += [
            _impossible(t, 'leaves', s, (NO_CLOSURE,))
            for t in ('shuttle_stack', 'cubesat', 'asteroid', 'upper_stage', 'juno')
        ]
        cases.append(_impossible('empty', 'still', s, (NO_TARGET,)))
    return cases


def _real_like() -> list[Case]:
    more: dict[str, Any] = {'sensor': REAL_LIKE, 'size': None}
    return [
        _case(t, 'spin', s, REAL_LIKE, **more)
        for t in ('asteroid', 'cubesat', 'shuttle_stack')
        for s in SEEDS
    ]


def _real() -> list[Case]:
    return [
        Case(
            TARGETS[r.name],
            'turntable' if r.name == 'bunny' else 'recorded',
            may_be_modelled=r.may_be_modelled,
            reasons=r.reasons,
            says=r.says,
        )
        for r in REAL.values()
    ]


_OBSERVABLE = ('curved and irregular', 'flat-faced and thin', 'near-axisymmetric')


def all_cases() -> list[Case]:
    """The whole matrix, held-out cases included, in a fixed order; the real recordings come last."""
    return [*_modelled(), *_strangers(), *_not_modelled(), *_real_like(), *_real()]


# What tells most, by experience; one seed.
_TELLING = (
    'shuttle_stack-spin-s0', 'shuttle_stack-tumble-s0', 'shuttle_stack-gaps-s0', 'shuttle_stack-spin-mli-s0',
    'shuttle_stack-spin-wall-s0', 'tank_boosters-swing-s0', 'tank_boosters-gaps-s0', 'asteroid-fast_spin-s0',
    'asteroid-gaps-s0', 'asteroid-spin-table-s0', 'itokawa-tumble-s0', 'prism-spin-s0', 'prism-tumble-s0',
    'cubesat-clohessy_wiltshire-s0', 'cubesat-gaps-s0', 'cubesat-spin-mli-s0',
    'defunct_satellite-tilted_spin-s0', 'defunct_satellite-tumble-s0', 'rosetta-spin-s0',
    'mir-reversed_spin-s0', 'mir-gaps-s0', 'upper_stage-spin-s0', 'upper_stage-tumble-s0',
    'upper_stage-spin-correlated-s0', 'upper_stage-spin-5hz-s0', 'tank-spin-s0', 'cylinder-spin-s0',
    'shuttle_stack-tracking_gaps-s0', 'defunct_satellite-tracking-s0', 'asteroid-leaves-s0',
    'shuttle_stack-still-s0', 'empty-still-s0', 'bunny-turntable-s0',
)  # fmt: skip


def _strata(case: Case) -> set[tuple[str, ...]]:
    """Groups of which the quick cases have at least one each."""
    sensor = str(case.options.get('sensor', KINECT1))
    return {
        ('target', case.target.name),
        ('motion', case.motion),
        ('condition', case.condition),
        ('sensor moves', sensor, str(case.motion in TUMBLES)),
    }


def _stratified() -> tuple[str, ...]:
    """The telling cases and, of the same seed, the fewest frames that fill the strata they leave empty.

    Classes and targets take turns.
    """
    new = {c.name for c in (*_real_like(), *_real()) if c.seed == 0 and c.name not in _TELLING}
    cases = {c.name: c for c in all_cases() if c.seed == 0 and not c.held_out and c.name not in new}
    chosen = list(_TELLING)
    empty = set().union(*map(_strata, cases.values())) - set().union(*(_strata(cases[n]) for n in chosen))
    turns = Counter(x for n in chosen for x in (cases[n].target.kind, cases[n].target.name))
    while empty:
        # the first of equals, so that the choice is the same everywhere
        best = max(
            cases.values(),
            key=lambda c: (
                len(_strata(c) & empty) / c.frames,
                -turns[c.target.kind],
                -turns[c.target.name],
                c.target.kind in _OBSERVABLE,
            ),
        )
        chosen.append(best.name)
        turns.update((best.target.kind, best.target.name))
        empty -= _strata(best)
    return (*chosen, *sorted(new))  # what came later moves none of the others


# Every development target, motion, sensor in spin and tumble, and condition at least once.
QUICK = _stratified()


# Each target before each sensor once in another motion: each motion and seed comes before each sensor.
_LATIN = {
    f'{t}-{MOTIONS_OF_SENSORS[1 + (i + j) % 3]}-{sensor}-s{SEEDS[(i + 2 * j) % 3]}'
    for i, t in enumerate(t.name for t in TARGETS.values() if not t.held_out and t.kind in _OBSERVABLE)
    for j, sensor in enumerate(SENSORS_CROSSED)
}
_HARD = ('1hz', '2hz', '3hz', '5hz', 'off_axis', 'correlated', SOME_MLI, *STOOD_ON)


def in_sample(case: Case) -> bool:
    """Whether it is one of some 380 that tell most: quick, each sensor, slow, on a desk, held out."""
    if case.name in QUICK or case.name in _LATIN or case.target.kind == STRANGER:
        return True
    if case.seed != 0 or case.target.kind not in _OBSERVABLE:
        return False
    if 'sensor' in case.options:
        return case.motion == 'spin'
    if case.condition in _HARD or case.motion in TURNTABLES:
        return case.target.name in ON_DESKS or case.held_out
    return case.held_out and case.motion in ('spin', 'tumble')
