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

"""What every node is built on, from the start of its process to its end.

1. ``middleware`` configures DDS and memory before rclpy starts; ``process`` makes the node, spins it, and
   saves what was gathered on SIGINT or SIGTERM.
2. ``stage`` is the base class: diagnostics, counted subscriptions and a reset. ``managed`` adds the lifecycle
   (configure, activate, deactivate, clean up) of the stages of a scan.
3. ``parameters`` declares and validates parameters; ``qos`` holds the profiles of all topics.
4. ``subscriptions`` counts messages and losses, and explains why a topic is silent; ``diagnostics`` reports.
5. ``worker`` runs heavy work in a thread of its own.
"""
