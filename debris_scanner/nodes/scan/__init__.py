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

"""The back end of a scan as a node runs it: ``graph`` with frames from other nodes, ``scanner`` with its own.

``joining`` reassembles frames and closures from their messages. ``scan_thread`` runs the back end in a
thread, publishes what it reports and saves its files. ``services`` lets users generate, save, finish, reset
and pause; ``idle_end`` finishes the scan when the input ends. ``frame_statistics`` accounts for every frame,
over all nodes.
"""
