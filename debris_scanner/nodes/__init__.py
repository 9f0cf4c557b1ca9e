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

"""ROS 2 nodes: thin shells that declare parameters, convert messages, call the scanner and publish.

The modules here are the executables. ``preprocess``, ``odometry``, ``closure`` and ``graph`` are the stages
of a scan in a process each; ``scanner`` runs them all in one. ``play_bag``, ``sim_kinect``,
``openni2_camera`` and ``freenect_camera`` publish depth frames, ``viewer`` shows the scan in a browser, and
``record_scan`` keeps its results in a bag.
``forked`` starts nodes of a live scan from one process, which has loaded ``preloaded``, and
``parameter_docs`` generates docs/parameters.md.

The folders hold what they share: ``lifecycle`` what every node is built on, ``inputs`` depth frames in and
out, ``publishing`` the topics of results, ``scan`` the back end as a node runs it, ``recovery`` the restart
of a node that was killed.
"""

from debris_scanner.kernel_cache import prepare_process

prepare_process()  # whoever imports this room is an executable
