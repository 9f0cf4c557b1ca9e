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

"""Node viewer over DDS: what is published is seen in a browser, garbage is counted, and it ends in words."""

import shutil

import numpy as np
import pytest
from browser import Browser, find_chromium
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Empty, String
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import Model, TargetFrame
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import OK
from msg_adapters.markers import graph_markers
from msg_adapters.models import mesh_marker, model_message
from msg_adapters.poses import odometry_message, path_message
from msg_adapters.target_frames import target_frame_message

pytestmark = pytest.mark.ros
FIELDS = "[...document.querySelectorAll('.reading, .state, .step, .answer')].map(e => e.textContent)"
SENSOR = 'camera_depth_optical_frame'


@pytest.fixture
def browser(tmp_path):
    path = find_chromium()
    if path is None:
        pytest.skip('no Chromium here; on Debian: apt-get install chromium')
    browser = Browser(path, tmp_path / 'profile')
    yield browser
    browser.close()
    shutil.rmtree(tmp_path / 'profile', ignore_errors=True)


def ball():
    """A model of 0.1 m radius."""
    normals = np.random.default_rng(0).normal(size=(3000, 3))
    normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
    triangles = np.arange(2997, dtype=np.int32).reshape(-1, 3)
    return Model(normals * np.float32(0.1), normals, normals * np.float32(0.1), triangles)


def disc(stamp_ns):
    v, u = np.mgrid[:80, :80]
    depth = np.where((u - 40) ** 2 + (v - 40) ** 2 < 35**2, 0.7, 0).astype(np.float32)
    normals = np.zeros((80, 80, 3), np.float32)
    normals[..., 2] = -1
    camera = Camera(300.0, 300.0, 39.5, 39.5, 80, 80)
    return target_frame_message(TargetFrame(stamp_ns, camera, depth, depth, normals), SENSOR)


def pose(stamp_ns, frame='target'):
    turned = np.radians(abs(stamp_ns * 10 % 200 - 100))  # to and fro between 0 and 100°
    T = transform(exp_so3(np.array([0, turned, 0])), np.array([0, 0, 0.8]))
    twist = np.array([0, np.deg2rad(30.0), 0, 0, 0, 0])
    return odometry_message(stamp_ns, SENSOR, frame, T, np.eye(6), twist, np.eye(6))


def start(nodes, peer, *parameters):
    nodes.start('viewer', ['--ros-args', *(p for q in ('port:=0', *parameters) for p in ('-p', q))])
    return peer.until(lambda: 'viewer' in peer.reports and peer.reports['viewer'], 'a report').values['url']


def coloured(browser):
    pixels = browser.screenshot()[200:, :780].astype(int)
    return float((np.abs(pixels - 26).max(axis=-1) > 40).mean())


def test_what_is_published_is_seen(nodes, peer, browser):
    model = ball()
    graph = graph_markers(1, 'target', [np.eye(4)] * 3, [(0, 1), (1, 2)], [(0, 2)])
    latched = {
        'model': model_message(model, 1, 'target'),
        'model_mesh': mesh_marker(model, 1, 'target'),
        'graph_markers': graph,
        'state': String(data='tracking'),
    }
    for topic, msg in latched.items():  # before the viewer comes
        peer.node.create_publisher(type(msg), topic, qos.latched()).publish(msg)
    url = start(nodes, peer)
    assert url.startswith('http://127.0.0.1:')
    points, odometry = (peer.talk(k, t) for k, t in ((PointCloud2, 'target_points'), (Odometry, 'odometry')))
    forecast = peer.talk(Path, 'forecast', qos.waiting())
    ahead = [(second * 10**9, transform(np.eye(3), np.array([0, 0, 0.8]))) for second in range(1, 61)]
    browser.visit(url, width=1100, height=700)
    stamps = iter(range(1, 10_000))

    def seen(text):
        points.publish(disc(stamp := next(stamps)))
        odometry.publish(pose(stamp))
        forecast.publish(path_message(stamp, SENSOR, ahead))
        peer.executor.spin_once()
        return browser.run(f'{FIELDS}.includes({text!r})')

    for text in ('tracking', '30.0 °/s', 'turn on: 100° of 360° seen', '0.800 m', '3000 points'):
        peer.until(lambda text=text: seen(text), text)
    peer.until(lambda: coloured(browser) > 0.03, 'a picture')
    peer.until(lambda: int(peer.reports['viewer'].values['clients']) == 1, 'the browser in the report')
    assert browser.complaints == []
    assert peer.reports['viewer'].level == OK
    assert peer.rejected('viewer') == {}

    # what is no scan of ours is counted and changes nothing
    odometry.publish(pose(next(stamps), 'no_frame_of_ours'))
    peer.until(lambda: peer.rejected('viewer') == {'malformed': 1}, 'the count')
    peer.talk(MarkerArray, 'graph_markers', qos.latched()).publish(MarkerArray(markers=[Marker()]))
    peer.until(lambda: peer.rejected('viewer') == {'malformed': 2}, 'the count')
    assert browser.run(f"{FIELDS}.includes('3000 points')")

    peer.talk(Empty, 'reset').publish(Empty())
    peer.until(lambda: browser.run(f"!{FIELDS}.includes('3000 points')"), 'a new scan')
    peer.until(lambda: coloured(browser) < 0.02, 'an empty scene')
    nodes.check()


def test_nothing_is_drawn_while_nobody_looks(nodes, peer):
    start(nodes, peer, 'max_rate_hz:=30.0')
    points = peer.talk(PointCloud2, 'target_points')
    for stamp in range(1, 20):
        points.publish(disc(stamp))
    first = peer.reports['viewer'].stamp_ns
    peer.until(lambda: peer.reports['viewer'].stamp_ns > first + 2_000_000_000, 'two more reports')
    assert peer.reports['viewer'].values['clients'] == '0'
    assert not peer.reports['viewer'].counts.get('drawn')


def test_a_taken_port_ends_it_with_one_line(nodes, peer):
    port = start(nodes, peer).rpartition(':')[2]
    nodes.start('viewer', ['--ros-args', '-p', f'port:={port}'], called='second')
    assert nodes.wait('second', 30)
    assert nodes.exit_code('second') == 2
    assert nodes.last_words('second').endswith(
        f'port {port} of 127.0.0.1 is in use: give another, or 0 for a free one'
    )
