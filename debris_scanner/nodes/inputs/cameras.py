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

"""The topics of the usual camera drivers as each starts by default, by the names of our inputs; no ROS."""

POINTS, DEPTH, INFO, COLOUR = 'points', 'depth/image_raw', 'depth/camera_info', 'rgb/image_raw'
MASK, DETECTION = 'mask', 'detection'

# Depth and colour of one size in one frame are used together; colour of another view is ignored by itself.
CAMERAS: dict[str, dict[str, str]] = {
    'realsense': {  # realsense2_camera, rs_launch.py
        DEPTH: '/camera/camera/depth/image_rect_raw',
        INFO: '/camera/camera/depth/camera_info',
    },
    'orbbec': {  # orbbec_camera, gemini_330_series.launch.py and others
        DEPTH: '/camera/depth/image_raw',
        INFO: '/camera/depth/camera_info',
        COLOUR: '/camera/color/image_raw',
    },
    'azure': {  # azure_kinect_ros_driver, driver.launch.py
        DEPTH: '/depth/image_raw',
        INFO: '/depth/camera_info',
        COLOUR: '/rgb_to_depth/image_raw',
    },
    'openni2': {POINTS: '/camera/depth_registered/points'},  # openni2_camera, camera_with_cloud.launch.py
    'kinect': {  # kinect_ros2, a Kinect v1
        DEPTH: '/depth/image_raw',
        INFO: '/depth/camera_info',
        COLOUR: '/image_raw',
    },
    'oak': {  # depthai_ros_driver, camera.launch.py
        DEPTH: '/oak/stereo/image_raw',
        INFO: '/oak/stereo/camera_info',
        COLOUR: '/oak/rgb/image_raw',
    },
    'zed': {  # zed_wrapper, zed_camera.launch.py
        DEPTH: '/zed/zed_node/depth/depth_registered',
        INFO: '/zed/zed_node/depth/camera_info',
        COLOUR: '/zed/zed_node/rgb/color/rect/image',
    },
    'livox': {POINTS: '/livox/lidar'},  # livox_ros_driver2 with xfer_format 0, a lidar
}
AXES = {'livox': '-y,-z,x'}  # of clouds in a body frame: x forward, z up


def parameters_of(camera: str) -> dict[str, str]:
    """Parameters for a camera: many send clouds beside their depth images, some send them in body axes."""
    axes = {'axes': AXES[camera]} if camera in AXES else {}
    return {'input': 'points' if POINTS in CAMERAS[camera] else 'depth'} | axes


def remappings_of(camera: str) -> list[str]:
    """The remappings for a camera, such as ``points:=/camera/points``."""
    return [f'{ours}:={theirs}' for ours, theirs in CAMERAS[camera].items()]
