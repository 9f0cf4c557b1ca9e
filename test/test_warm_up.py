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
import subprocess
import sys

import pytest

from debris_scanner.tracking import odometry
from debris_scanner.warm_up import warm_up


def test_a_logger_need_not_look_at_all_modules_any_more():
    warm_up()
    assert inspect.modulesbyfile[odometry.__file__] == odometry.__name__


@pytest.mark.parametrize('stage', ['preprocess', 'odometry', 'closure'])
def test_a_stage_loads_none_of_the_libraries_that_models_need(stage):
    code = (
        'import sys\n'
        'from debris_scanner.warm_up import warm_up\n'
        f'warm_up({stage!r})\n'
        'print(*(n for n in ("networkx", "trimesh", "scipy.stats") if n in sys.modules))'
    )
    warm_up()  # compiles
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_the_first_coloured_frame_compiles_nothing():
    code = (
        'from debris_scanner.warm_up import warm_up\n'
        'warm_up("odometry")\n'
        'from debris_scanner.registration import picture_terms\n'
        'from debris_scanner.sensing import picture\n'
        'kernels = picture.colour_ratios, picture._smoothed, picture._looked_up\n'
        'kernels += picture_terms._evidence, picture_terms.reconcile\n'
        'print(*(len(kernel.signatures) for kernel in kernels))'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ['1'] * 5
