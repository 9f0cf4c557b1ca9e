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

"""Half hidden key frames are told by the others; what is out of place is not excused as half hidden."""

import numpy as np
import pytest
from occluded_frames import shaded

from debris_scanner.core.geometry import compose, transform
from debris_scanner.mapping.pose_graph import occluded_views
from debris_scanner.sensing.views import View

STEP = 4  # frames between key frames: 11 degrees


@pytest.fixture(scope='module')
def posed(recording):
    frames = range(0, 20 * STEP, STEP)
    return [recording.views[k] for k in frames], [recording.pose(k) for k in frames]


def with_shade(recording, posed, members, share=0.5):
    return [
        View(shaded(recording.targets[n * STEP], share)) if n in members else v
        for n, v in enumerate(posed[0])
    ]


def test_whole_views_miss_nothing(posed):
    assert occluded_views(*posed) == set()


@pytest.mark.parametrize('members', [{7}, {0, 1}, {11, 12, 13, 14}])
def test_the_others_tell(recording, posed, members):
    assert occluded_views(with_shade(recording, posed, members), posed[1]) == members


def test_where_most_are_told_so_none_is(recording, posed):
    assert occluded_views(with_shade(recording, posed, {0, 3, 6, 9, 12, 15, 18}), posed[1]) == set()


@pytest.mark.parametrize('shift', [(0.03, 0, 0), (0, 0.04, 0), (0.0, 0.0, 0.02)])
def test_what_is_out_of_place_is_no_evidence_of_a_shadow(posed, shift):
    views, poses = posed
    moved = [compose(T, transform(np.eye(3), np.array(shift))) if n == 7 else T for n, T in enumerate(poses)]
    assert occluded_views(views, moved) == set()
