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

"""Depth cameras through OpenNI2 and libfreenect, without ROS; each device lives in a process of its own.

1. `supervisor` starts `device_process` and restarts it after a fault. C libraries that abort, hang or leak
   cannot take the node with them.
2. `device_process` opens an `openni2_device` or a `freenect_device` through `openni2_library` or
   `freenect_library`. `captures` says what a device delivers.
3. `device_clock` turns device times into stamps and limits the rate. `kinect_depth` turns raw disparity into
   millimetres.
4. `channel` carries the images through a pipe.

`faults`, `usb_access` and `library_check` name what went wrong and what helps.
"""
