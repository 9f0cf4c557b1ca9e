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

"""What is scanned: the simulator's targets and recorded meshes, each with its size, its class, its fate."""

import os
from dataclasses import dataclass
from pathlib import Path

from benchmarks.real_recordings import REAL
from benchmarks.strangers import STRANGERS

CURVED, FLAT, NEAR_AXISYMMETRIC = 'curved and irregular', 'flat-faced and thin', 'near-axisymmetric'
UNOBSERVABLE, NOTHING = 'unobservable', 'nothing'
RECORDING, STRANGER = 'real recording', 'stranger'


@dataclass(frozen=True)
class ScoredTarget:
    """One target of the matrix."""

    name: str
    kind: str  # class, one of those above
    mesh: str | None = None  # file in the folder of meshes; None for a target of the simulator
    size: float | None = None  # largest extent, metres; None takes the simulator's own
    held_out: bool = False  # not looked at while developing
    may_be_unobservable: bool = False  # so nearly round that the reason "unobservable" is right too
    may_be_too_shiny: bool = False  # in insulation no two faces show in one frame: refusing is right too


# The meshes as the loader leaves them: every one loads, with all triangles; sizes chosen so that parts are
# no thinner than a few pixels at 0.8 m. Atlantis, its tank and booster and Mir are open shells with inner
# surfaces (cargo bay, cabin, nozzle): no ray reaches those from outside but through slits, and what no
# pixel measured does not count for completeness. They can only make a model's error smaller.
TARGETS = {
    t.name: t
    for t in (
        ScoredTarget('shuttle_stack', CURVED),
        ScoredTarget('tank_boosters', CURVED),
        ScoredTarget('asteroid', CURVED),
        ScoredTarget('itokawa', CURVED, '25143itokawa.obj', 0.35),
        ScoredTarget('atlantis', CURVED, 'Atlantis.obj', 0.40, held_out=True),
        ScoredTarget('churyumov', CURVED, 'churyumov.obj', 0.28, held_out=True),
        ScoredTarget('prism', FLAT),
        ScoredTarget('cubesat', FLAT, may_be_too_shiny=True),
        ScoredTarget('defunct_satellite', FLAT),
        ScoredTarget('rosetta', FLAT, 'Rosetta.stl', 0.45),
        ScoredTarget('mir', FLAT, 'Mir.obj', 0.40),
        ScoredTarget('carina', FLAT, 'Carina.obj', 0.35, held_out=True),
        ScoredTarget('juno', FLAT, 'Juno.stl', 0.45, held_out=True),
        ScoredTarget('upper_stage', NEAR_AXISYMMETRIC),
        ScoredTarget('tank', NEAR_AXISYMMETRIC, 'Atlantis_tank.obj', 0.42, may_be_unobservable=True),
        ScoredTarget(
            'booster', NEAR_AXISYMMETRIC, 'Atlantis_SRB.obj', 0.45, held_out=True, may_be_unobservable=True
        ),
        ScoredTarget('cylinder', UNOBSERVABLE),
        ScoredTarget('empty', NOTHING),
        *(ScoredTarget(name, RECORDING) for name in REAL),
        *(ScoredTarget(f'stranger{n:02d}', STRANGER, held_out=True) for n in STRANGERS),
    )
}


def data_folder() -> Path:
    """Where recorded data and meshes lie: ``DEBRIS_SCANNER_DATA``, or beside the repository."""
    default = Path(__file__).resolve().parents[3] / 'shared' / 'data'
    return Path(os.environ.get('DEBRIS_SCANNER_DATA', default)).resolve()


def mesh_file(target: ScoredTarget) -> Path | None:
    """The target's mesh file, None if it is one of the simulator's."""
    return None if target.mesh is None else data_folder() / 'meshes' / target.mesh


def available(target: ScoredTarget) -> bool:
    """Whether what the target needs is there."""
    if target.kind == RECORDING:
        return (data_folder() / REAL[target.name].path).exists()
    mesh = mesh_file(target)
    return mesh is None or mesh.is_file()
