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

"""Everything that can be set in the thesis's method, as in params/thesis_table_4_1.yaml and its siblings.

The defaults are those of Table 4.1 where it prints a number, else of the text, else PCL's.
"""

from dataclasses import dataclass, field

from debris_scanner.core.parameters import ParameterError, parameter
from debris_scanner.mapping.descriptors import DescriptorSettings
from debris_scanner.research.thesis.attitude_ekf import EkfSettings
from debris_scanner.research.thesis.refiner import RefinerSettings
from debris_scanner.sensing.isolation import IsolationSettings

ESTIMATORS = ('ekf', 'batch')
SIMILARITIES = ('float', 'binary_median', 'binary_mean', 'binary_per_bin', 'normalised')
SEARCHES = ('frugal', 'greedy')
METHODS = ('lum', 'elch', 'elch+lum')


def _one_of(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ParameterError(f'{name} {value!r} is none of {", ".join(choices)}')


@dataclass(frozen=True)
class OdometrySettings:
    """Frame-to-frame alignment, the rate estimator, and which frames are kept."""

    sample_rate: float = parameter(5.0, 'frames a second; more are thinned out', 'Hz', 0.01, 1000.0)
    voxel: float = parameter(0.002, 'edge of the voxel grid on every frame', 'm', 1e-4, 0.1)
    max_distance: float = parameter(0.01, 'largest distance of an ICP correspondence', 'm', 1e-4, 1.0)
    iterations: int = parameter(50, 'most ICP iterations', '', 1, 10000)
    tolerance: float = parameter(1e-12, 'change of d_k that ends ICP (eq. 2.8)', 'm²', 0.0)
    max_gap: float = parameter(
        1.5, 'longest time between linked frames, in sampling periods (section 3.2)', '', 0.0
    )
    keyframe_angle_deg: float = parameter(
        10.0, 'turn between kept frames (section 3.2, fig. 3.4); 0 keeps all', 'deg', 0.0, 90.0
    )
    estimator: str = parameter('ekf', 'ekf (section 2.8) or batch (section 2.7)')
    planar: bool = parameter(True, 'the batch processor allows a spin about y alone (eq. 2.59)')

    def __post_init__(self) -> None:
        _one_of('estimator', self.estimator, ESTIMATORS)


@dataclass(frozen=True)
class ClosureRule:
    """When two frames close a loop."""

    similarity: str = parameter(
        'float', 'float, binary_median, binary_mean, binary_per_bin or normalised (sections 2.10.3-4, 5.3)'
    )
    search: str = parameter('frugal', 'frugal (eq. 2.84) or greedy (eq. 2.83)')
    min_probability: float = parameter(0.82, 'P_closure,min', '', 0.0, 1.0)
    min_period: float = parameter(0.5, 'rotation between the two frames, in turns (eq. 2.84)', '', 0.0)
    preceding: int = parameter(3, 'directly preceding frames that greedy search links (section 4.4)', '', 0)
    directed: bool = parameter(True, 'cycles follow the edges forwards only (section 3.2)')

    def __post_init__(self) -> None:
        _one_of('similarity', self.similarity, SIMILARITIES)
        _one_of('search', self.search, SEARCHES)


@dataclass(frozen=True)
class RelaxationSettings:
    """How the loop's error is shared out: the nested Lu-Milios loop, ELCH, or that ahead of it."""

    method: str = parameter(
        'lum', 'lum (section 2.2.5), elch (section 2.2.6), which relaxes nothing, or elch+lum'
    )
    outer_iterations: int = parameter(60, 'most searches for correspondences', '', 1, 100000)
    inner_iterations: int = parameter(60, 'most relaxation steps between two searches', '', 1, 100000)
    tolerance: float = parameter(1e-9, 'mean change of a pose that ends either loop', 'm, rad', 0.0)
    max_distance: float = parameter(0.01, 'largest distance of a correspondence', 'm', 1e-4, 1.0)
    voxel: float = parameter(
        0.0, 'voxel grid on the clouds that are relaxed; 0 takes them as they are', 'm', 0.0, 0.1
    )
    check_stability: bool = parameter(True, 'refuse networks that start unstable (section 6.2.1)')

    def __post_init__(self) -> None:
        _one_of('method', self.method, METHODS)


@dataclass(frozen=True)
class ThesisSettings:
    """The whole method, one group a step. ``isolation`` is for the preprocessing ahead of it."""

    isolation: IsolationSettings = field(default_factory=IsolationSettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)
    ekf: EkfSettings = field(default_factory=EkfSettings)
    descriptor: DescriptorSettings = field(default_factory=DescriptorSettings)
    closure: ClosureRule = field(default_factory=ClosureRule)
    relaxation: RelaxationSettings = field(default_factory=RelaxationSettings)
    refiner: RefinerSettings = field(default_factory=RefinerSettings)
