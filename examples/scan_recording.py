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

"""Scan a rosbag with your own settings: ``python examples/scan_recording.py BAG OUT``."""

import sys
from pathlib import Path

import debris_scanner as ds
from msg_adapters.bags import open_session
from msg_adapters.errors import MalformedMessage


def main(bag: Path, out: Path) -> ds.ScanResult:
    """Scan a recording with a target no further away than 3 m, and save the result."""
    settings = ds.Settings().updated({'isolation.box_max': (2.0, 2.0, 3.0)})
    scanner = ds.Scanner(settings)
    with open_session(bag) as session:
        for _, frame in session:  # a DepthFrame each, or why a message is none
            if isinstance(frame, MalformedMessage):
                scanner.reject(frame.reason, str(frame))
            else:
                scanner.process(frame)
    result = scanner.finish()
    print(f'{result.frames_read} frames, {"a model" if result else result.reason}: {result.save(out)}')
    return result


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2]))
