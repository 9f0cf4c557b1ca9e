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

"""The package as colcon, rosdep and pip see it, and the direction of its imports."""

import ast
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
import xml.etree.ElementTree as ET
from itertools import chain
from pathlib import Path

import networkx as nx
import pytest

import debris_scanner
from tools.debian import is_ros, known

ROOT = Path(__file__).resolve().parents[1]
EXECUTABLES = (
    'preprocess',
    'odometry',
    'closure',
    'graph',
    'scanner',
    'sim_kinect',
    'play_bag',
    'openni2_camera',
    'freenect_camera',
    'record_scan',
    'viewer',
)
ROS = {
    'rclpy',
    'rcl_interfaces',
    'builtin_interfaces',
    'diagnostic_msgs',
    'geometry_msgs',
    'lifecycle_msgs',
    'nav_msgs',
    'rosgraph_msgs',
    'sensor_msgs',
    'std_msgs',
    'std_srvs',
    'tf2_ros',
    'tf2_msgs',
    'vision_msgs',
    'visualization_msgs',
    'launch',
    'launch_ros',
}
# Rooms from the ground up; a room imports those below it alone.
FLOORS = (
    ('core',),
    ('kernel_cache', 'interruption', 'faults', 'sensing', 'drivers', 'viewer'),
    ('registration',),
    ('mapping',),
    ('tracking',),
    ('modelling',),
    ('io',),
    ('settings', 'sim'),
    ('recorder', 'evaluation', 'merging', 'stages'),
    ('back_end', 'report'),
    ('scanner', 'two_views'),
    ('warm_up',),
    ('batch', 'msg_adapters'),
    ('research', 'nodes'),
    ('cli',),
    ('__main__', 'benchmarks'),
)
MEET_ROS = ('msg_adapters', 'nodes', 'cli', 'benchmarks')


@pytest.fixture(scope='module')
def manifest():
    return ET.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def arguments():
    """The arguments that setup.py gives to setuptools."""
    code = (
        'import json, runpy, setuptools\n'
        'setuptools.setup = lambda **given: print(json.dumps(given, default=str))\n'
        'runpy.run_path("setup.py", run_name="__main__")'
    )
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_setup_runs_from_another_folder_and_through_a_link(tmp_path):
    """As colcon does it: in a folder of links, of which the README is none."""
    (tmp_path / 'setup.py').symlink_to(ROOT / 'setup.py')
    for path in (ROOT / 'setup.py', tmp_path / 'setup.py'):
        command = [sys.executable, str(path), '--name', '--version']
        done = subprocess.run(command, cwd='/', capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == [debris_scanner.__name__, debris_scanner.__version__]


def imports(path):
    """Top-level names of the modules a file imports anywhere, functions included, and whole names."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path} uses a relative import'
            names |= {node.module} | {f'{node.module}.{alias.name}' for alias in node.names}
    return names


def sources(package):
    return sorted((ROOT / package).rglob('*.py'))


def relative(path):
    return path.relative_to(ROOT).as_posix()


def test_manifest_is_a_valid_format_3_package(manifest):
    assert manifest.tag == 'package'
    assert manifest.get('format') == '3'
    assert re.fullmatch(r'\d+\.\d+\.\d+', manifest.findtext('version'))
    assert manifest.findtext('export/build_type') == 'ament_python'
    assert manifest.findtext('license') == 'Apache-2.0'
    assert manifest.findtext('description').strip()
    # an address that catkin_pkg finds invalid silently makes this a package without ROS
    assert re.fullmatch(r'[\w.-]+@[\w-]+(\.[a-z]{2,})+', manifest.find('maintainer').get('email'))
    depends = [e.text for e in manifest if e.tag.endswith('depend')]
    assert len(depends) == len(set(depends))


def test_manifest_and_setup_agree(manifest, arguments):
    assert arguments['name'] == manifest.findtext('name') == debris_scanner.__name__
    assert arguments['version'] == manifest.findtext('version') == debris_scanner.__version__
    assert arguments['license'] == manifest.findtext('license')
    assert arguments['maintainer_email'] == manifest.find('maintainer').get('email')
    assert 'Apache License' in (ROOT / 'LICENSE').read_text()


def test_manifest_names_every_ros_package_that_is_imported(manifest):
    used = {
        n.split('.')[0]
        for package in (debris_scanner.__name__, 'msg_adapters')
        for f in sources(package)
        for n in imports(f)
    }
    depends = {e.text for e in manifest if e.tag.endswith('depend')}
    package = {'tf2_ros': 'tf2_ros_py'}  # tf2_ros is the package for C++
    assert {package.get(name, name) for name in used & ROS} <= depends


def test_rosdep_has_every_key_on_ubuntu_24_04(manifest):
    rules = known()
    keys = {e.text for e in manifest if e.tag.endswith('depend') and not is_ros(e.text)}
    assert keys == set(rules)  # the copy has no key that nobody uses
    for key, rule in rules.items():
        assert set(rule) <= {'apt', 'pip'} and all(rule.values()), key
        assert ('pip' in rule) == key.endswith('-pip')


def test_every_package_and_data_file_is_installed(arguments):
    packages = {
        relative(p.parent).replace('/', '.') for n in ('debris_scanner', 'msg_adapters') for p in sources(n)
    }
    assert packages == set(arguments['packages'])
    installed = {source: target for target, files in arguments['data_files'] for source in files}
    assert installed['package.xml'] == 'share/debris_scanner'
    assert installed['resource/debris_scanner'] == 'share/ament_index/resource_index/packages'
    for pattern, target in (
        ('launch/*.launch.py', 'share/debris_scanner/launch'),
        ('params/*.yaml', 'share/debris_scanner/params'),
        ('rviz/*', 'share/debris_scanner/rviz'),
        ('scripts/*', 'lib/debris_scanner'),
    ):
        for path in ROOT.glob(pattern):
            assert installed[relative(path)] == target
    for package in ('debris_scanner', 'msg_adapters'):
        assert (ROOT / package / 'py.typed').is_file()  # its types count for those who use it
        assert arguments['package_data'][package] == ['py.typed']
    assert list((ROOT / 'debris_scanner' / 'nodes' / 'lifecycle').glob('*.xml'))
    assert arguments['package_data']['debris_scanner.nodes.lifecycle'] == ['*.xml']
    assert arguments['package_data']['debris_scanner.report'] == ['page.css', 'page.js']
    assert {'page.css', 'page.js'} <= {p.name for p in (ROOT / 'debris_scanner' / 'report').iterdir()}


def test_executables_for_ros2_run():
    assert {p.name for p in (ROOT / 'scripts').iterdir()} >= set(EXECUTABLES)
    for path in (ROOT / 'scripts').iterdir():
        assert os.access(path, os.X_OK), path
        module = re.search(r'from (debris_scanner\.nodes\.\w+) import main', path.read_text()).group(1)
        assert module == f'debris_scanner.nodes.{path.name}'
        assert callable(importlib.import_module(module).main)


def test_wrapper_uses_the_interpreter_beside_it(tmp_path):
    installed, beside = tmp_path / 'lib' / 'debris_scanner' / 'graph', tmp_path / 'bin' / 'python3'
    for path in (installed, beside):
        path.parent.mkdir(parents=True)
    installed.write_bytes((ROOT / 'scripts' / 'graph').read_bytes())
    beside.write_text('#!/bin/sh\nfor a in "$@"; do printf "<%s>" "$a"; done\n')
    for path in (installed, beside):
        path.chmod(0o755)
    done = subprocess.run(
        [installed, '--ros-args', '-r', 'a:=b c'], capture_output=True, text=True, check=True
    )
    assert done.stdout.endswith('<--ros-args><-r><a:=b c>')
    assert 'debris_scanner.nodes.graph' in done.stdout


def test_command_line_entry_points(arguments):
    for entry in arguments['entry_points']['console_scripts']:
        module, function = re.fullmatch(r'[\w-]+ = ([\w.]+):(\w+)', entry).groups()
        assert callable(getattr(importlib.import_module(module), function))


def test_constraints_pin_every_requirement(arguments):
    lines = [s for s in (ROOT / 'constraints.txt').read_text().splitlines() if not s.startswith('#')]
    pinned = dict(line.split('==') for line in lines)
    assert all(pinned.values())
    wanted = [*arguments['install_requires'], *chain(*arguments['extras_require'].values())]
    for requirement in wanted:
        if 'platform_machine !=' in requirement:
            continue
        name = re.match(r'[\w.-]+', requirement).group().lower().replace('_', '-')
        assert name in pinned, name


def test_rosbags_is_bounded(arguments):
    """Its interface moved from one release to the next before."""
    (rosbags,) = [r for r in arguments['extras_require']['scan'] if r.startswith('rosbags')]
    assert '<0.12' in rosbags
    code = (ROOT / 'msg_adapters' / 'raw_messages.py').read_text()
    assert 'get_typestore(Stores.ROS2_JAZZY)' in code


def test_setup_names_every_library_that_is_imported(arguments):
    distribution = {
        'yaml': 'pyyaml',
        'PIL': 'pillow',
        'skimage': 'scikit-image',
        'open3d': 'open3d-cpu',
        'backports': 'backports.zstd',
    }
    extras = arguments['extras_require']
    wanted = ('scan', 'drivers', 'view', 'batch')
    requirements = [*arguments['install_requires'], *(r for name in wanted for r in extras[name])]
    declared = {re.match(r'[\w.-]+', r).group().lower() for r in requirements}
    used = {
        n.split('.')[0] for p in ('debris_scanner', 'msg_adapters') for f in sources(p) for n in imports(f)
    }
    used -= set(sys.stdlib_module_names) | ROS | {'debris_scanner', 'msg_adapters'}
    missing = {n for n in used if distribution.get(n, n).replace('_', '-') not in declared}
    assert missing == set()


def room(name):
    """The room of a module's dotted name: its folder under debris_scanner, or its own name."""
    parts = name.split('.')
    return parts[0] if parts[0] != 'debris_scanner' else parts[1] if len(parts) > 1 else ''


def modules():
    """Dotted name of every module of the product, and its file."""
    for package in ('debris_scanner', 'msg_adapters', 'benchmarks'):
        for path in sources(package):
            yield relative(path).removesuffix('.py').removesuffix('/__init__').replace('/', '.'), path


def test_imports_run_one_way():
    """A room imports rooms below it alone; messages and ROS stay with those on top."""
    floor = {name: height for height, names in enumerate(FLOORS) for name in names}
    checked = 0
    for module, path in modules():
        if module == 'debris_scanner':
            continue
        own = room(module)
        checked += 1
        for name in imports(path):
            if name.split('.')[0] in ROS:
                assert own in MEET_ROS, f'{module} imports {name}'
            if name.split('.')[0] not in ('debris_scanner', 'msg_adapters', 'benchmarks'):
                continue
            other = room(name)
            if other in ('', '__version__'):
                continue
            assert other in floor, f'{module} imports {name}: on no floor'
            assert other == own or floor[other] < floor[own], f'{module} imports {name}'
    assert checked > 150


def test_no_modules_import_each_other_in_a_circle():
    graph = nx.DiGraph()
    known = dict(modules())
    for module, path in known.items():
        for name in imports(path):
            found = next((n for n in (name, name.rpartition('.')[0]) if n in known), None)
            # a face names what its room holds; that the room's modules belong to it is no circle
            if found and found != module and not module.startswith(found + '.'):
                graph.add_edge(module, found)
    circles = [c for c in nx.strongly_connected_components(graph) if len(c) > 1]
    assert circles == []


def test_every_room_has_a_face():
    for _, path in modules():
        if path.name == '__init__.py':
            assert ast.get_docstring(ast.parse(path.read_text())), relative(path)


def test_project_settings_match_the_oldest_python(arguments):
    settings = tomllib.loads((ROOT / 'pyproject.toml').read_text())
    assert arguments['python_requires'] == f'>={settings["tool"]["mypy"]["python_version"]}'


def test_an_executable_that_is_interrupted_while_it_loads_ends_as_asked():
    """Python alone would die of the signal, and a launch would call that a failure."""
    command = [sys.executable, '-c', 'import signal, os; signal.signal(signal.SIGINT, signal.SIG_DFL); '
               f'os.execv({str(ROOT / "scripts" / "graph")!r}, ["graph"])']  # fmt: skip
    bare = Path(sys.prefix, 'bin')
    environment = os.environ | {'PATH': f'{bare}{os.pathsep}{os.environ["PATH"]}', 'PYTHONPATH': str(ROOT)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as node:
        # in the middle of its imports: rclpy's are there, the node is not
        end = time.monotonic() + 60
        while 'numpy' not in Path(f'/proc/{node.pid}/maps').read_text():
            assert time.monotonic() < end
            time.sleep(0.01)
        node.send_signal(signal.SIGINT)
        _, said = node.communicate(timeout=60)
    assert node.returncode == 0, said
    assert 'Traceback' not in said


def test_tests_of_faults_run_only_where_they_are_asked_for():
    """`colcon test` calls pytest without more; they take half an hour."""
    command = [sys.executable, '-m', 'pytest', '--collect-only', '-q', 'test/nodes/test_faults.py']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert re.search(r'no tests collected \([1-9]\d* deselected\)', done.stdout), done.stdout


def test_the_tests_children_can_be_interrupted_even_if_make_runs_in_the_background(tmp_path):
    """`nohup make test &`: the shell has SIGINT ignored, which children inherit."""
    (tmp_path / 'conftest.py').write_bytes((ROOT / 'test' / 'conftest.py').read_bytes())
    (tmp_path / 'test_child.py').write_text(
        'import signal, subprocess, sys\n'
        'def test_child():\n'
        '    code = "import signal; print(signal.getsignal(signal.SIGINT))"\n'
        '    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout\n'
        '    assert "default_int_handler" in said\n'
    )
    command = f'trap "" INT; exec {sys.executable} -m pytest -q -p no:dash {tmp_path}'
    done = subprocess.run(['sh', '-c', command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
