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

"""The verb ``live``: which nodes run, how they are watched, and how the scan ends.

``verb`` reads the command line; ``source`` says where frames come from: a bag, the simulator, a camera.
``supervision`` starts the nodes as ``processes``, on a ``domain`` of their own, follows them through the
``monitor`` and restarts what dies; ``view`` is the browser's.
"""

from debris_scanner.cli.live.verb import add_arguments, run

__all__ = ['add_arguments', 'run']
