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

"""From pruned graph to the spring network that is relaxed: clouds about where they belong, and their links.

Trowbridge 2014, sections 2.2.6 and 3.2; thesis parts T17 and T18. The thesis moves every cloud by itself, its
centroid to the origin. ELCH instead closes the loops of the odometry as they are, which needs the target's
translation to be known as well as its attitude, and can stand alone: it compares two clouds a closure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply, compose, inverse, transform
from debris_scanner.core.voxel_grid import voxel_grid
from debris_scanner.mapping.frame_graph import FrameEdge, FrameGraph
from debris_scanner.research.thesis import elch
from debris_scanner.research.thesis.frame_registration import prealign, register_points
from debris_scanner.research.thesis.lum import Link, RelaxationError
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.settings import RelaxationSettings


@dataclass(frozen=True)
class Network:
    """Frames of a pruned graph; lists run over ``members``."""

    members: list[int]  # indices of the odometry's clouds
    clouds: list[Array]  # points (n, 3), metres, moved
    before: list[Array]  # T_target_sensor (4, 4) that moved them
    links: list[Link]


def network(graph: FrameGraph, motion: Odometry, settings: RelaxationSettings) -> Network:
    """Network of the graph's frames, moved as ``settings.method`` says.

    Raises:
        RelaxationError: if ELCH cannot align the two frames of a closure.
    """
    index = {motion.clouds[k].stamp_ns: k for k in motion.kept}
    members = [index[stamp] for stamp in graph.stamps]
    placed = [prealign(motion.clouds[k].points, motion.attitudes[k]) for k in members]
    if settings.method != 'lum':
        closures = [e for e in graph.edges() if e.probability is not None]
        poses = closed_by_elch(members, closures, motion, settings)
        placed = [
            (apply(T, motion.clouds[k].points.astype(np.float64)), T)
            for k, T in zip(members, poses, strict=True)
        ]
    clouds = [_thinned(points, settings.voxel).astype(np.float64) for points, _ in placed]
    place = {k: n for n, k in enumerate(members)}
    # a closure between neighbours doubles an edge that is there
    links = sorted({(place[index[e.earlier_ns]], place[index[e.later_ns]]) for e in graph.edges()})
    return Network(members, clouds, [T for _, T in placed], links)


def closed_by_elch(
    members: Sequence[int], closures: Sequence[FrameEdge], motion: Odometry, settings: RelaxationSettings
) -> list[Array]:
    """T_target_sensor (4, 4) of the members: chained alignments, each closure's error shared out on its loop.

    A frame's share is that of the rotation travelled, eq. 2.26; frames after the loop follow its last. Loops
    are closed one after another, so where they overlap a later one takes a little back from those before.

    Raises:
        RelaxationError: if the two frames of a closure cannot be aligned.
    """
    # correction by a share of the rotation has to turn about the target, not about the far-off sensor
    centroid = motion.clouds[members[0]].points.mean(axis=0, dtype=np.float64)
    first_pose = compose(transform(np.eye(3), -centroid), motion.poses[members[0]])
    poses = [compose(first_pose, inverse(motion.poses[k])) for k in members]
    place = {motion.clouds[k].stamp_ns: n for n, k in enumerate(members)}
    for closure in closures:
        first, last = place[closure.earlier_ns], place[closure.later_ns]
        wanted = compose(poses[first], _alignment(motion, members[first], members[last], settings))
        loop = compose(wanted, inverse(poses[last]))
        shares = elch.travelled_shares(np.diff(motion.path[members[first : last + 1]]))
        poses[first : last + 1] = elch.close_loop(poses[first : last + 1], loop, shares)
        poses[last + 1 :] = [compose(loop, T) for T in poses[last + 1 :]]
    return poses


def _alignment(motion: Odometry, earlier: int, later: int, settings: RelaxationSettings) -> Array:
    """T_earlier_later (4, 4) by ICP of two frames that show the same face."""
    source, target = motion.clouds[later].points, motion.clouds[earlier].points
    # the drift is beyond the reach of ICP, but faces that are the same have their centroids in common
    _, T_later = prealign(source, motion.attitudes[later])
    _, T_earlier = prealign(target, motion.attitudes[earlier])
    aligned = register_points(
        _thinned(source, settings.voxel),
        _thinned(target, settings.voxel),
        settings.max_distance,
        settings.outer_iterations,
        initial=compose(inverse(T_earlier), T_later),
    )
    if aligned is None:
        first, last = motion.clouds[earlier].stamp_ns, motion.clouds[later].stamp_ns
        raise RelaxationError(f'frames {first} and {last} of a closure cannot be aligned')
    return aligned.T_target_source


def _thinned(points: NDArray[np.floating], voxel: float) -> NDArray[np.floating]:
    return points if voxel == 0 else voxel_grid(points, voxel)
