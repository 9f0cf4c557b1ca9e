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

"""The verb ``live``: starts the nodes as processes, supervises the scan, and ends it.

``verb`` reads the command line; ``source`` chooses the input: a bag, the simulator, or a camera.
``supervision`` starts the nodes as ``processes`` on a ``domain`` of their own, follows the scan through the
``monitor``, and restarts nodes that die. ``view`` reports the address of the browser view.
"""

from debris_scanner.cli.live.verb import add_arguments, run

__all__ = ['add_arguments', 'run']
