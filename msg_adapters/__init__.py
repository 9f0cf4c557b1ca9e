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

"""numpy to and from ROS messages and bags; only nodes, verbs and benchmarks import this room.

Messages: ``stamps``, ``clouds``, ``depth_images`` and ``colour_images`` convert what sensors send,
``target_frames``, ``poses`` and ``records`` what nodes exchange, ``models`` and ``markers`` what viewers
show. Readers raise :mod:`msg_adapters.errors` with one line of text.

``inputs`` makes depth frames of them, whatever the drivers' habits, offline as live.

Bags: ``raw_messages`` and ``raw_bags`` read any storage as undecoded messages, ``salvage`` the intact part of
damaged files. ``bags`` decodes the depth frames of a session, and ``bag_writer`` writes one.
"""
