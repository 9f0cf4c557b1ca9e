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

"""What is set before rclpy starts and what is not changed; clouds then arrive."""

import os
import platform
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import namedtuple
from pathlib import Path

import pytest

from debris_scanner.nodes.lifecycle import middleware
from debris_scanner.nodes.lifecycle.middleware import (
    MB,
    PROFILE_VARIABLE,
    choose_profile,
    keep_large_buffers,
    prepare,
)

VARIABLES = (PROFILE_VARIABLE, 'AMENT_PREFIX_PATH', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY')
Usage = namedtuple('Usage', 'total used free')


@pytest.fixture(autouse=True)
def bare(monkeypatch):
    """An environment that says nothing, and is put back afterwards."""
    for name in VARIABLES:
        monkeypatch.setenv(name, 'x')  # so that monkeypatch restores what prepare() sets
        monkeypatch.delenv(name)


def shared_memory(monkeypatch, total_mb, free_mb):
    usage = Usage(total_mb * MB, (total_mb - free_mb) * MB, free_mb * MB)
    monkeypatch.setattr(middleware.shutil, 'disk_usage', lambda folder: usage)


def segment(profile):
    """Shared-memory segment of a profile in bytes, 0 where it has none."""
    space = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    tree = ET.parse(profile).getroot()
    declared = {d.findtext(f'{space}transport_id'): d for d in tree.iter(f'{space}transport_descriptor')}
    used = [e.text for e in tree.find(f'.//{space}userTransports')]
    assert set(used) == set(declared)
    assert 'UDPv4' in {declared[name].findtext(f'{space}type') for name in used}
    assert tree.findtext(f'.//{space}useBuiltinTransports') == 'false'
    return sum(int(declared[name].findtext(f'{space}segment_size') or 0) for name in used)


@pytest.mark.parametrize(
    ('total', 'free', 'segment_bytes'),
    [
        (8000, 7000, middleware.LARGE_SEGMENT_BYTES),
        (512, 400, middleware.LARGE_SEGMENT_BYTES),
        (512, 50, middleware.SMALL_SEGMENT_BYTES),
        (64, 64, middleware.SMALL_SEGMENT_BYTES),
        (64, 10, middleware.SMALL_SEGMENT_BYTES),
        (64, 4, 0),
    ],
)
def test_profile_fits_shared_memory(monkeypatch, total, free, segment_bytes):
    shared_memory(monkeypatch, total, free)
    profile, remark = choose_profile()
    assert segment(profile) == segment_bytes
    assert bool(remark) == (segment_bytes != middleware.LARGE_SEGMENT_BYTES)
    if remark:
        assert f'{free} of {total} MB' in remark


def test_no_shared_memory_at_all():
    profile, remark = choose_profile(Path('/nonexistent'))
    assert segment(profile) == 0
    assert '/nonexistent' in remark


def test_prepare_sets_the_profile_and_says_what_is_not_ideal(monkeypatch):
    shared_memory(monkeypatch, 64, 60)
    (remark,) = prepare()
    assert '60 of 64 MB' in remark
    assert segment(os.environ[PROFILE_VARIABLE]) == middleware.SMALL_SEGMENT_BYTES


@pytest.mark.parametrize('local', [False, True])
@pytest.mark.parametrize(
    ('total', 'of_images', 'of_stages'),
    [
        (8000, middleware.LARGE_SEGMENT_BYTES, middleware.STAGE_SEGMENT_BYTES),
        (16, middleware.SMALL_SEGMENT_BYTES, middleware.SMALL_STAGE_SEGMENT_BYTES),
        (1, 0, 0),
    ],
)
def test_only_who_sends_images_allocates_a_large_segment(monkeypatch, local, total, of_images, of_stages):
    shared_memory(monkeypatch, total, total)
    prepare(local_only=local)
    sender = os.environ[PROFILE_VARIABLE]
    assert segment(sender) == of_images
    assert prepare(images=False) == []  # a stage that inherits it says nothing again
    stage = os.environ[PROFILE_VARIABLE]
    assert segment(stage) == of_stages
    addresses = [
        [e.text for e in ET.parse(p).getroot().iter() if e.tag.endswith('}address')] for p in (sender, stage)
    ]
    assert addresses[0] == addresses[1] == (['127.0.0.1'] if local else [])
    prepare()  # a simulator that inherits it from who supervises
    assert os.environ[PROFILE_VARIABLE] == sender
    shared_memory(monkeypatch, total, 0)  # others have filled it since
    assert len(prepare(images=False)) == (of_images > 0)
    assert segment(os.environ[PROFILE_VARIABLE]) == 0
    monkeypatch.setenv(PROFILE_VARIABLE, '/my/fastdds_profile.xml')
    prepare(images=False)
    assert os.environ[PROFILE_VARIABLE] == '/my/fastdds_profile.xml'


def test_users_profile_stays(monkeypatch):
    monkeypatch.setenv(PROFILE_VARIABLE, '/my/own.xml')
    shared_memory(monkeypatch, 64, 60)
    assert prepare() == []
    assert os.environ[PROFILE_VARIABLE] == '/my/own.xml'


def test_discovery_reaches_the_network_unless_asked():
    prepare()
    assert 'ROS_AUTOMATIC_DISCOVERY_RANGE' not in os.environ
    prepare(local_only=True)
    assert os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'


@pytest.mark.parametrize(
    ('name', 'value'), [('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET'), ('ROS_LOCALHOST_ONLY', '1')]
)
def test_users_discovery_range_stays(monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    prepare(local_only=True)
    assert {n: os.environ[n] for n in VARIABLES[2:] if n in os.environ} == {name: value}


@pytest.mark.parametrize(
    ('variable', 'asked', 'local'),
    [
        (None, True, True),
        (None, False, False),
        (('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET'), True, False),
        (('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST'), False, True),
        (('ROS_LOCALHOST_ONLY', '1'), False, True),
    ],
)
@pytest.mark.parametrize('free_mb', [1000, 60, 4])
def test_who_keeps_to_this_host_hears_the_loopback_alone(monkeypatch, variable, asked, local, free_mb):
    shared_memory(monkeypatch, 1000, free_mb)
    plain, _ = choose_profile()
    if variable:
        monkeypatch.setenv(*variable)
    prepare(local_only=asked)
    profile = Path(os.environ[PROFILE_VARIABLE])
    assert segment(profile) == segment(plain)
    assert [e.text for e in ET.parse(profile).getroot().iter() if e.tag.endswith('}address')] == (
        ['127.0.0.1'] if local else []
    )


def test_prefix_path_of_a_pip_installation(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    prepare()
    assert 'AMENT_PREFIX_PATH' not in os.environ  # nothing installed there
    (tmp_path / 'share' / 'ament_index').mkdir(parents=True)
    prepare()
    assert os.environ['AMENT_PREFIX_PATH'] == str(tmp_path)
    monkeypatch.setenv('AMENT_PREFIX_PATH', '/opt/ros/jazzy')
    prepare()
    assert os.environ['AMENT_PREFIX_PATH'] == '/opt/ros/jazzy'


def test_malloc_settings_are_taken_on_glibc():
    assert keep_large_buffers() == (platform.libc_ver()[0] == 'glibc')


CLOUDS = 45
PUBLISHER = f"""
import array, time
from debris_scanner.nodes.lifecycle.middleware import prepare
prepare()
import rclpy
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node('source')
publisher = node.create_publisher(PointCloud2, 'cloud', 5)
while publisher.get_subscription_count() < 1:
    time.sleep(0.01)
input()  # the other side has matched too: what is sent before that is lost to it by right
data = array.array('B', bytes(4_900_000))
for k in range({CLOUDS}):
    publisher.publish(PointCloud2(width=k, data=data))
    time.sleep(1 / 30)
input()  # all are read: shared memory goes with its writer
"""
SUBSCRIBER = f"""
import time
from debris_scanner.nodes.lifecycle.middleware import prepare
prepare()
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node('sink')
seen = []
node.create_subscription(
    PointCloud2, 'cloud', lambda m: seen.append(m.width), qos_profile_sensor_data,
    event_callbacks=SubscriptionEventCallbacks(matched=lambda status: print('matched', flush=True)),
)
deadline = time.monotonic() + 60
while len(seen) < {CLOUDS} and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.2)
print('seen', seen, flush=True)
"""


@pytest.mark.ros
@pytest.mark.timing  # best effort at 30 Hz: others would take its time
def test_every_cloud_of_a_kinect_arrives_in_another_process(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '62')
    sink = subprocess.Popen([sys.executable, '-c', SUBSCRIBER], stdout=subprocess.PIPE, text=True)
    source = subprocess.Popen([sys.executable, '-c', PUBLISHER], stdin=subprocess.PIPE, text=True)
    assert sink.stdout and source.stdin
    try:
        assert sink.stdout.readline() == 'matched\n'
        source.stdin.write('go\n')
        source.stdin.flush()
        said = next(line for line in sink.stdout if line.startswith('seen'))  # it may match again
        assert said.strip() == f'seen {list(range(CLOUDS))}'
    finally:
        sink.kill()
        source.kill()


def test_another_middleware_keeps_its_own_settings(monkeypatch):
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    (remark,) = prepare()
    assert 'the middleware is rmw_cyclonedds_cpp' in remark
    assert PROFILE_VARIABLE not in os.environ


@pytest.mark.parametrize(
    ('what', 'period_s'),
    [
        ('leaseAnnouncement', 0.5),  # a node that was killed is back by then
        ('heartbeatPeriod', 0.2),  # what was lost is sent again, long before who joins messages gives up
    ],
)
def test_each_profile_repeats_itself_in_time(what, period_s):
    profiles = list(Path(middleware.__file__).parent.glob('*.xml'))
    assert len(profiles) == 10
    for profile in profiles:
        tree = ET.parse(profile).getroot()
        period = next(element for element in tree.iter() if element.tag.endswith(what))
        seconds, nanoseconds = (int(part.text) for part in period)
        assert seconds + 1e-9 * nanoseconds == period_s, profile.name
