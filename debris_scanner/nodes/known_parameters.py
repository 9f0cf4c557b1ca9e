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

"""Parameters that the nodes declare for themselves, so that a file for all of them may name them.

A test compares this with what the nodes declare.
"""

_CAMERA = (
    'colour',
    'cx',
    'cy',
    'device',
    'frame_id',
    'fx',
    'fy',
    'library',
    'max_rate_hz',
    'registered',
    'rgb_frame_id',
    'wait_for_stages',
    'wait_for_subscribers',
)

NODES: dict[str, tuple[str, ...]] = {
    'preprocess': ('autostart', 'input', 'input_depth', 'input_reliability', 'journal_dir'),
    'odometry': (
        'autostart',
        'journal_dir',
    ),
    'closure': (
        'autostart',
        'journal_dir',
    ),
    'graph': (
        'autostart',
        'exit_after_idle',
        'finish_after_idle',
        'journal_dir',
        'max_mesh_triangles',
        'output_dir',
    ),
    'scanner': (
        'autostart',
        'exit_after_idle',
        'finish_after_idle',
        'input',
        'input_depth',
        'input_reliability',
        'journal_dir',
        'max_mesh_triangles',
        'output_dir',
    ),
    'sim_kinect': (
        'axis_sensor',
        'clutter',
        'colour',
        'correlated',
        'frame_id',
        'gaps',
        'gaps_from_s',
        'leaves_s',
        'mli',
        'motion',
        'noise',
        'patchy',
        'range_m',
        'rate_hz',
        'seconds',
        'seed',
        'size',
        'spin_rad_s',
        'stay',
        'target',
        'truth_dir',
        'wait_for_stages',
        'wait_for_subscribers',
    ),
    'play_bag': ('bag', 'loops', 'rate', 'stay', 'topic', 'wait_for_stages', 'wait_for_subscribers'),
    'openni2_camera': tuple(sorted((*_CAMERA, 'height', 'repeat', 'width'))),
    'freenect_camera': _CAMERA,
    'viewer': ('host', 'max_points', 'max_rate_hz', 'port'),
}
