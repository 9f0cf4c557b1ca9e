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

"""Another host on the same network, built from network namespaces, neither sees nor reaches a local scan."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros

LONGEST_S = 120.0  # they end by themselves after some 20 s
SHARED_MEMORY = 'mount -t tmpfs -o size=200m tmpfs /dev/shm'
LOOPBACK = 'ip link set lo up'
# a node that says in the end whom it has seen: its name, whether it keeps to this host, for how many seconds
NODE = """
import os, sys, time
name, kind, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
if kind != 'driver':
    from debris_scanner.nodes.lifecycle.middleware import prepare
    prepare(local_only=kind == 'local')
import rclpy
rclpy.init()
node = rclpy.create_node(name)
seen, end = set(), time.monotonic() + seconds
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
    seen |= set(node.get_node_names())
sys.stdout.write(' '.join([name, 'saw', *sorted(seen)]) + '\\n')  # at once: the others write to the same pipe
sys.stdout.flush()
os._exit(0)  # the middleware may hang at the interpreter's end, at full load, and for ever
"""
# scan, driver and stranger: the stranger's host is 10.9.0.2, and it asks for 10.9.0.1 by name
HOSTS = f"""
set -e
{SHARED_MEMORY}; {LOOPBACK}
unshare -n -m sh -c '{SHARED_MEMORY}; echo $$ > "$FOLDER/other"; {LOOPBACK}
    until ip link show vb >/dev/null 2>&1; do sleep 0.1; done
    ip addr add 10.9.0.2/24 dev vb; ip link set vb up; ip route add default dev vb
    ROS_STATIC_PEERS=10.9.0.1 "$PYTHON" "$FOLDER/node.py" stranger network 14' &
until [ -s "$FOLDER/other" ]; do sleep 0.1; done
ip link add va type veth peer name vb netns "$(cat "$FOLDER/other")"
ip addr add 10.9.0.1/24 dev va; ip link set va up; ip route add default dev va
sleep 1
"$PYTHON" "$FOLDER/node.py" driver driver 12 &
"$PYTHON" "$FOLDER/node.py" scan "$KIND" 12
wait
"""


def seen(tmp_path, domain_environment, kind):
    """Names that each of the three has seen."""
    (tmp_path / 'node.py').write_text(NODE)
    environment = domain_environment | {'FOLDER': str(tmp_path), 'PYTHON': sys.executable, 'KIND': kind}
    hosts = subprocess.Popen(
        ['unshare', '-n', '-m', 'sh', '-c', HOSTS],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        out, errors = hosts.communicate(timeout=LONGEST_S)
    finally:  # of the group, nothing stays behind
        with contextlib.suppress(ProcessLookupError):
            os.killpg(hosts.pid, signal.SIGKILL)
    said = [line.split(' saw ') for line in out.splitlines() if ' saw ' in line]
    assert len(said) == 3, errors
    return {name: set(names.split()) for name, names in said}


@pytest.fixture
def environment(monkeypatch):
    """Of a user who has set nothing."""
    trial = f'{SHARED_MEMORY} && {LOOPBACK} && ip link add x type veth peer name y'
    try:
        permitted = subprocess.run(
            ['unshare', '-n', '-m', 'sh', '-c', trial], capture_output=True, check=False
        ).returncode
    except OSError:
        permitted = 1
    if permitted:
        pytest.skip('network namespaces are not permitted here')
    ours = ('ROS_', 'FASTRTPS_')
    return {k: v for k, v in os.environ.items() if not k.startswith(ours)} | {'ROS_DOMAIN_ID': '5'}


def test_a_local_scan_is_out_of_reach_but_hears_the_driver_beside_it(tmp_path, environment):
    names = seen(tmp_path, environment, 'local')
    assert 'scan' not in names['stranger']
    assert names['scan'] == {'scan', 'driver'}
    assert 'scan' in names['driver']


def test_with_network_given_it_is_seen(tmp_path, environment):
    names = seen(tmp_path, environment, 'network')
    assert 'scan' in names['stranger']
    assert names['scan'] == {'scan', 'driver', 'stranger'}
