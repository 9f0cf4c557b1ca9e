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

"""Names of the target's frames in messages and TF."""

import re
from dataclasses import dataclass

from rclpy.node import Node

from debris_scanner.core.parameters import ParameterError
from debris_scanner.nodes.lifecycle.parameters import declare


@dataclass(frozen=True)
class FrameNames:
    """TF is one tree for all namespaces, so two scanners need a prefix each."""

    prefix: str = ''

    @property
    def sensor(self) -> str:
        """The sensor's optical frame by a name that does not depend on the driver, for displays."""
        return f'{self.prefix}sensor'

    @property
    def scanning(self) -> str:
        """The target frame before there is a model: that of the first key frame, with odometry's drift."""
        return f'{self.prefix}target_scanning'

    @property
    def target(self) -> str:
        """The target frame of the model."""
        return f'{self.prefix}target'

    def of(self, tracked: bool) -> str:
        """The frame of a pose that was registered to a model, or was not."""
        return self.target if tracked else self.scanning


def declared_frame_names(node: Node) -> FrameNames:
    """The names that the parameter ``frame_prefix`` of a node makes.

    Raises:
        ParameterError: the prefix makes no frame names.
    """
    prefix = declare(node, 'frame_prefix', '', 'before the names of target frames, as in left/target')
    if not re.fullmatch(r'([A-Za-z_][\w/.-]*)?', prefix, re.ASCII):
        raise ParameterError(f'frame_prefix must begin with a letter and have no spaces, got {prefix!r}')
    return FrameNames(prefix)
