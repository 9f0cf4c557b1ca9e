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

"""How a restarted node continues the scan of the process that was killed.

Nodes write journals while they scan, and resume from them: what is in them, and how it is read back, is in
``debris_scanner.io``: ``odometry_journal`` and ``scan_journal``. After a restart, ``catching_up`` reads what
the node missed before it takes messages again. ``scanner_journal`` is the pair of journals that the composed
scanner writes.
"""
