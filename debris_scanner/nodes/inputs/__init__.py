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

"""Depth frames in and out of the graph of nodes.

``synchroniser`` subscribes to a camera's clouds or depth images and pairs them with mask and colour;
``sensor_input`` decodes them and puts their stamps in order. ``sources`` is what the player and the simulator
share: they wait for subscribers, then publish a series in real time. ``camera_driver`` publishes the images
of a device that may be unplugged and come back.
"""
