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

"""Recordings in which something goes wrong: frames missing, silence, a clock that is set."""

import shutil
from collections.abc import Callable

from debris_scanner.core.results import StampedPose
from debris_scanner.io.trajectories import read_tum, write_tum
from debris_scanner.nodes.play_bag import restamped
from msg_adapters.bag_writer import BagWriter
from msg_adapters.raw_bags import open_bag

Change = Callable[[int], 'tuple[int, int] | None']


def altered(bag, path, change: Change):
    """A copy of a recording.

    Args:
        bag: with depth images.
        path: of the copy.
        change: of a frame's number, to how much later, ns, it comes and how much later it is stamped; None
            leaves it out.
    """
    numbers: dict[int, int] = {}  # by the bag's time
    shifts: dict[int, int] = {}
    with open_bag(bag) as source, BagWriter(path) as writer:
        for raw in source.messages():
            number = numbers.setdefault(raw.stamp_ns, len(numbers))
            moved = change(number)
            if moved is None:
                continue
            later_ns, stamped_ns = moved
            shifts[number] = stamped_ns
            writer.write_raw(raw.topic, raw.msgtype, raw.stamp_ns + later_ns, restamped(raw.data, stamped_ns))
    truth = read_tum(bag / 'truth.tum')
    assert len(truth) == len(numbers)
    write_tum(
        path / 'truth.tum',
        [StampedPose(p.stamp_ns + shifts[k], p.T_sensor_target) for k, p in enumerate(truth) if k in shifts],
    )
    shutil.copy(bag / 'truth_mesh.ply', path)
    return path
