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

"""The shapes of the odd targets; scans of them are run_fuzz.py's."""

import numpy as np
import odd_targets
import pytest


@pytest.mark.parametrize('kind', odd_targets.KINDS)
def test_a_shape_is_a_mesh(kind):
    mesh = odd_targets.SHAPES[kind](np.random.default_rng(3))
    assert len(mesh.faces) >= 12 and np.isfinite(mesh.vertices).all()
    assert (np.ptp(mesh.vertices, axis=0) > 0).all()
