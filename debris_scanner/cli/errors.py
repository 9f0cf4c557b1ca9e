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

"""Exit codes of every verb, and the error for input that a verb cannot use."""

DONE = 0
BAD_INPUT = 2
NO_MODEL = 3

ROS_REMEDY = 'source /opt/ros/jazzy/setup.bash, or: pip install "debris_scanner[ros]"'


class CliError(Exception):
    """Input that a verb cannot use: printed as one line on stderr, exit code 2."""
