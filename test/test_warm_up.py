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

"""What the warm-up spares the first real frame."""

import inspect
import os
import subprocess
import sys

import pytest

from debris_scanner.kernel_cache import WITHOUT_COLOUR
from debris_scanner.tracking import odometry
from debris_scanner.warm_up import warm_up


def test_a_logger_need_not_look_at_all_modules_any_more():
    warm_up()
    assert inspect.modulesbyfile[odometry.__file__] == odometry.__name__


NEVER = {'networkx', 'rosbags', 'trimesh', 'scipy.stats'}  # by these stages
LATER = {
    # a support that was learnt
    'preprocess': """
from debris_scanner.sensing.support import _unevenness
assert _unevenness(np.arange(99.0), 5.0) > 1
""",
    # a frame with colours, whose kernels are compiled, and the forecast of an even turn
    'odometry': """
from debris_scanner.registration import picture_terms
from debris_scanner.sensing import picture
kernels = picture.logarithms, picture.unshade, picture._smoothed, picture._looked_up
kernels += picture_terms._evidence, picture_terms.reconcile
assert [len(kernel.signatures) for kernel in kernels] == [1] * 6
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.tracking.dynamics import fit_dynamics
turns = [exp_so3(np.array([0.0, 0.0, 0.1 * k])) for k in range(60)]
poses = [StampedPose(k * 10**8, transform(R, np.array([0.0, 0.0, 1.0]))) for k, R in enumerate(turns)]
assert fit_dynamics(poses, 1e-3, 0.3) is not None
""",
    # a search among earlier key frames
    'closure': """
from debris_scanner.mapping.closure_search import candidates
assert candidates(np.arange(9), np.linspace(0, 1, 9), np.zeros(9), 9.0)
""",
}


@pytest.mark.parametrize('stage', LATER)
def test_a_stage_loads_what_it_needs_before_its_first_frame_and_nothing_else(stage):
    """Loading costs a live stage frames, and memory: what models need, one stage alone has."""
    code = (
        'import sys\n'
        'import numpy as np\n'
        f'import debris_scanner.nodes.{stage}\n'
        'from debris_scanner.warm_up import warm_up\n'
        f'warm_up({stage!r})\n'
        'before = set(sys.modules)\n'
        f'{LATER[stage]}'
        'print(*(name for name in set(sys.modules) - before if not name.startswith("debris_scanner")))\n'
        f'print(*({NEVER} & set(sys.modules)))\n'
    )
    warm_up()  # compiles
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout == '\n\n'


def test_a_scan_without_colour_compiles_no_kernel_for_it():
    """`live` knows that of a simulation, and tells its nodes by the environment."""
    code = (
        'from debris_scanner.warm_up import warm_up\n'
        'warm_up("odometry")\n'
        'from debris_scanner.registration import picture_terms\n'
        'print(len(picture_terms._evidence.signatures))'
    )
    without = os.environ | {WITHOUT_COLOUR: '1'}
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True, env=without
    )
    assert done.stdout == '0\n'
