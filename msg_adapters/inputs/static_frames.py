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

"""The frames of a robot that do not move, by /tf_static: where a cloud lies in its camera's optical frame."""

from typing import Any

import numpy as np

from debris_scanner.core.geometry import Array, from_quaternion, inverse, transform

try:
    import tf2_msgs.msg as tf2_messages
except ImportError:
    tf2_messages = None

TF_STATIC = '/tf_static'
TF_TYPE: Any = getattr(tf2_messages, 'TFMessage', None)  # None where it is not installed
OPTICAL_WORD = 'optical'  # in the name of a frame whose z points forward


class StaticFrames:
    """Transforms that do not change; those of later messages replace earlier ones of the same child."""

    def __init__(self) -> None:
        self._links: dict[str, dict[str, dict[str, Array]]] = {}

    def add(self, message: Any) -> None:
        """Take a tf2_msgs/TFMessage; transforms that are none are left out."""
        for t in message.transforms:
            r, p = t.transform.rotation, t.transform.translation
            q = np.array([r.x, r.y, r.z, r.w], np.float64)
            T_position = np.array([p.x, p.y, p.z], np.float64)
            if not (np.isfinite(T_position).all() and np.isfinite(q).all() and np.linalg.norm(q) > 0):
                continue
            parent, child = _name(t.header.frame_id), _name(t.child_frame_id)
            T = transform(from_quaternion(q), T_position)
            self._links.setdefault(parent, {})[child] = {'T': T}
            self._links.setdefault(child, {})[parent] = {'T': inverse(T)}

    def optical(self, frame_id: str) -> tuple[str, Array] | None:
        """The optical frame nearest to a frame by links, a depth camera's first, and T_optical_frame.

        None if no optical frame is connected with it.
        """
        start = _name(frame_id)
        if start not in self._links:
            return None
        import networkx as nx  # late: a node whose clouds lie in their optical frame starts without it

        paths = nx.single_source_shortest_path(nx.DiGraph(self._links), start)
        ranked = sorted(
            (len(path), 'depth' not in name, name) for name, path in paths.items() if OPTICAL_WORD in name
        )
        if not ranked:
            return None
        name = ranked[0][2]
        T_start_end = np.eye(4)
        for parent, child in zip(paths[name][:-1], paths[name][1:], strict=True):
            T_start_end = T_start_end @ self._links[parent][child]['T']
        return name, inverse(T_start_end)


def _name(frame_id: Any) -> str:
    return str(frame_id).lstrip('/')
