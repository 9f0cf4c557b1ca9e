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

"""A small ring whose odometry turns too far, with what each method makes of it."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.geometry import apply, exp_so3, inverse, rotation_angle, transform
from debris_scanner.mapping.frame_graph import FrameGraph, FrameGraphSettings
from debris_scanner.research.thesis.lum import RelaxationError
from debris_scanner.research.thesis.network import network
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.settings import RelaxationSettings

STEP = np.radians(10)


@dataclasses.dataclass
class Seen:
    stamp_ns: int
    points: np.ndarray


def turned(angle):
    return transform(exp_so3(np.array([0, angle, 0])), np.array([0, 0, 1.0]))


def ring(n, drift=0.01):
    """Odometry of n frames of a blob that turns by ten degrees each and seems to turn by more."""
    blob = np.random.default_rng(3).normal(size=(400, 3)) * [0.1, 0.05, 0.02]
    accepted = [turned(STEP * (1 + drift) * k) for k in range(n)]
    return Odometry(
        clouds=[Seen(k, apply(turned(STEP * k), blob)) for k in range(n)],
        observations=[],
        alignments=[],
        attitudes=[T[:3, :3] for T in accepted],
        poses=[T @ inverse(accepted[0]) for T in accepted],
        path=STEP * (1 + drift) * np.arange(n),
        rates=[],
        kept=list(range(n)),
    )


def graph(n, *closures):
    g = FrameGraph(FrameGraphSettings(directed=True))
    for k in range(n):
        g.add_frame(k, linked=True)
    for earlier, later in closures:
        g.add_closure(earlier, later, 0.9)
    return g


def worst_attitude(net):
    """Radians, against the first frame."""
    return max(
        rotation_angle(net.before[0][:3, :3].T @ T[:3, :3] @ turned(STEP * k)[:3, :3])
        for k, T in zip(net.members, net.before, strict=True)
    )


def scatter(net):
    """Farthest that any two frames place the same point, metres."""
    return np.ptp(np.array(net.clouds), axis=0).max()


def test_elch_shares_out_what_lum_is_left_to_relax():
    motion = ring(37)
    closed = network(graph(37, (0, 36)), motion, RelaxationSettings(method='elch'))
    moved = network(graph(37, (0, 36)), motion, RelaxationSettings(method='lum'))
    assert worst_attitude(moved) == pytest.approx(np.radians(3.6))
    assert worst_attitude(closed) < np.radians(0.05)
    assert scatter(closed) < 0.2 * scatter(moved)
    assert closed.links == moved.links == sorted([(k, k + 1) for k in range(36)] + [(0, 36)])
    assert np.abs(np.mean(closed.clouds[0], axis=0)).max() < 1e-9


def test_every_closure_is_used_and_later_frames_follow():
    net = network(graph(40, (0, 36), (1, 37)), ring(40), RelaxationSettings(method='elch+lum'))
    assert len(net.members) == 40
    # the last two frames lie on no loop: what they drifted since is left
    assert worst_attitude(net) == pytest.approx(np.radians(0.2), abs=np.radians(0.05))


def test_frames_that_share_nothing_close_no_loop():
    motion = ring(37)
    motion.clouds[36].points = np.random.default_rng(0).normal(size=(50, 3)) * 1000
    with pytest.raises(RelaxationError, match='frames 0 and 36'):
        network(graph(37, (0, 36)), motion, RelaxationSettings(method='elch'))


def test_a_grid_thins_the_clouds():
    thin = network(graph(5, (0, 4)), ring(5), RelaxationSettings(method='elch', voxel=0.05))
    assert max(map(len, thin.clouds)) < 200
