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

"""Sphinx, for rosdoc2 and by itself: ``make api``; the pages of the API come from the docstrings."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from debris_scanner import __version__  # noqa: E402

project = 'debris_scanner'
author = 'debris_scanner maintainers'
copyright = '2026, debris_scanner maintainers'
version = release = __version__
extensions = ['sphinx.ext.autodoc', 'sphinx.ext.apidoc', 'sphinx.ext.napoleon', 'myst_parser']
source_suffix = {'.rst': 'restructuredtext', '.md': 'markdown'}
exclude_patterns = ['_build', 'thesis']
html_theme = 'alabaster'
# what builds the pages needs no ROS, and none of the large libraries: those that are missing are mocked
_LARGE = [
    'ament_index_python',
    'builtin_interfaces',
    'diagnostic_msgs',
    'geometry_msgs',
    'lifecycle_msgs',
    'nav_msgs',
    'numba',
    'open3d',
    'openni',
    'rcl_interfaces',
    'rclpy',
    'rosbags',
    'rosgraph_msgs',
    'sensor_msgs',
    'std_msgs',
    'std_srvs',
    'tf2_ros',
    'vision_msgs',
    'viser',
    'visualization_msgs',
    'websockets',
]
autodoc_mock_imports = [name for name in _LARGE if importlib.util.find_spec(name) is None]
autodoc_typehints = 'none'
autodoc_use_type_comments = False  # there are none, and each function's source is read for them
autodoc_member_order = 'bysource'
apidoc_modules = [
    {'path': str(ROOT / package), 'destination': f'api/{package}', 'separate_modules': False, 'max_depth': 2}
    for package in ('debris_scanner', 'msg_adapters')
]
myst_enable_extensions = ['dollarmath']
myst_fence_as_directive = ['math']
suppress_warnings = ['myst.xref_missing', 'myst.header', 'toc.not_included', 'ref.python']
