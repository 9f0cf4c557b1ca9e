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

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from setuptools import Distribution, find_packages, setup

root = Path(__file__).resolve().parent  # colcon --symlink-install: links to this file, but not to the README
os.chdir(Path(__file__).absolute().parent)  # setuptools and the patterns below look in the working folder
name = 'debris_scanner'
share = f'share/{name}'
version = re.search(r"__version__ = '([^']+)'", (root / name / '__init__.py').read_text()).group(1)
manifest = ET.parse(root / 'package.xml')  # who is asked, and under which licence
maintainer = manifest.find('maintainer')


SCAN = [
    'libusb-package; sys_platform == "linux"',  # Open3D wants a libusb; bare containers have none
    'numba>=0.60',
    'open3d-cpu>=0.19; platform_machine == "x86_64"',
    'open3d>=0.19; platform_machine != "x86_64"',
    'rosbags>=0.10.5,<0.12',
]


def files(pattern):
    return sorted(str(path) for path in Path().glob(pattern) if path.is_file())


class WithData(Distribution):
    # An editable install asks for `has_data`, which setuptools does not define, and so drops data_files.
    has_data = Distribution.has_data_files


setup(
    distclass=WithData,
    name=name,
    version=version,
    description='Scan a rotating object with a depth sensor: close the loop, model it, track it',
    long_description=(root / 'README.md').read_text(),
    long_description_content_type='text/markdown',
    author=manifest.findtext('author'),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get('email'),
    license=manifest.findtext('license'),
    python_requires='>=3.11',
    packages=find_packages(include=[f'{name}*', 'msg_adapters*']),
    package_data={
        name: ['py.typed'],
        'msg_adapters': ['py.typed'],
        f'{name}.nodes.lifecycle': ['*.xml'],
        f'{name}.report': ['page.css', 'page.js'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (share, ['package.xml']),
        (f'{share}/launch', files('launch/*.launch.py')),
        (f'{share}/params', files('params/*.yaml')),
        (f'{share}/rviz', files('rviz/*')),
        # `ros2 run` looks here; pip does not honour install_scripts, so the wrappers travel as data.
        (f'lib/{name}', files('scripts/*')),
    ],
    install_requires=[
        'backports.zstd>=1; python_version < "3.14"',
        'lz4>=4',
        'matplotlib>=3.8',
        'networkx>=3.2',
        'numpy>=1.26',
        'pillow>=10',
        'plotly>=6.1,<8',
        'psutil>=5.9',
        'PyYAML>=6',
        'scikit-image>=0.22',
        'scipy>=1.11',
        'tqdm>=4.60',
        'trimesh>=4.5',
    ],
    extras_require={
        # Where ROS 2 Jazzy is installed already, leave this out: rclpy and the messages come with it.
        'ros': [*SCAN, 'ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        # What scans: libraries that rosdep does not know. Without them all imports, and says what is off.
        'scan': SCAN,
        # Cameras without a ROS driver of their own: the libraries are apt's libopenni2-0 and libfreenect0.5.
        'drivers': ['openni>=2.3,<3'],
        # The live view in a browser.
        'view': ['viser>=1.0,<2', 'rich>=13', 'websockets>=15'],
        # Many recordings, the scorecard and `reproduce`; stores beside s3 and ssh: what fsspec names.
        'batch': [
            'bokeh>=3.1',  # the dashboard
            'cloudpickle>=3',
            'dask>=2024.8',
            'distributed>=2024.8',
            'fsspec>=2024.6',
            'paramiko>=3',
            'pyarrow>=15',
            's3fs>=2024.6',
        ],
        'test': ['hypothesis', 'pytest'],  # colcon test looks for this one
        'dev': [
            'flask',
            'flask-cors',
            'hypothesis',
            'moto[s3]',
            'mujoco-core',
            'mypy',
            'pytest',
            'pytest-cov',
            'pytest-xdist',
            'ruff',
        ],
        # the API's pages: docs/conf.py
        'doc': ['myst-parser', 'sphinx'],
    },
    entry_points={'console_scripts': ['debris-scan = debris_scanner.cli.main:main']},
    zip_safe=False,
)
