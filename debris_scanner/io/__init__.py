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

"""Files: what a scan writes, what it is given, and what it resumes from.

`result_files` writes a finished scan: models (`model_files`), poses and pose graph (`trajectories`), summary.
`files` writes a file whole or not at all, and files that belong together all or none. `mesh_files` reads
meshes and clouds, `recordings` folders and files of depth as people have them.

While a scan runs, `journal` appends records to a file. `scan_journal`, `odometry_journal` and `recent_frames`
use it, so that a killed process continues where it stopped; the closure node keeps a mark of its own.
"""
