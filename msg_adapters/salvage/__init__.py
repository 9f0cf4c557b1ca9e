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

"""Readers for bags that a crash cut off or damaged: every message that is still intact.

Each walks the file itself, without index: ``mcap`` and ``rosbag1`` record by record, ``sqlite`` row by row.
``mapped_files`` reads only those parts of a file that the walk looks at.
"""
