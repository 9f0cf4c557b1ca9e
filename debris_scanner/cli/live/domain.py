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

"""A free ROS domain, so that two scans on one machine do not receive each other's messages."""

import os
import socket

# Fast DDS derives its ports from the domain; those of higher domains are ephemeral ports.
DOMAINS = range(1, 102)
_BASE_PORT, _PORTS_A_DOMAIN = 7400, 250


def free_domain(start: int | None = None) -> int:
    """A domain without a participant on this machine; searched from ``start``, by default our process id.

    Raises:
        OSError: all are in use.
    """
    first = os.getpid() if start is None else start
    for k in range(len(DOMAINS)):
        domain = DOMAINS[(first + k) % len(DOMAINS)]
        port = _BASE_PORT + _PORTS_A_DOMAIN * domain
        if _unbound(port) and _unbound(port + 10):  # of multicast discovery, and of the first participant
            return domain
    raise OSError('every ROS domain from 1 to 101 is in use on this machine')


def _unbound(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True
