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

"""Folders and files of depth that people have, each as a :class:`~.recording.Recording`.

``layouts`` finds out which layout it is. ``depth_folders`` reads depth images with intrinsics (ours, Open3D's
recorder, TUM RGB-D, BOP), ``cloud_sequences`` clouds (PCD, PLY, npz), ``matroska`` the videos of an Azure
Kinect. ``names`` orders files by the numbers or times in their names, and pairs them.
"""
