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

"""Coverage-guided fuzzing of the adapters, for as long as one likes:

    pip install atheris && python test/fuzz/guided.py [-max_total_time=600]

The first two bytes choose message and reader, the others are its serialised bytes. Atheris is no dependency
of this package; see run_fuzz.py for what runs in CI.
"""

import contextlib
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parents[1])]

import atheris  # noqa: E402

import debris_scanner.scanner  # noqa: E402, F401  its kernels are compiled, and must not be instrumented

with atheris.instrument_imports(include=['msg_adapters']):
    import message_cases

from rclpy.serialization import serialize_message  # noqa: E402

KINDS = list(message_cases.seeds().values())


def one_input(data: bytes) -> None:
    if len(data) < 6:
        return
    messages, read = KINDS[data[0] % len(KINDS)]
    message_cases.parse(data[2:], data[1] % len(messages), messages, read)


def corpus(folder: Path) -> None:
    """Whole messages to begin with."""
    folder.mkdir(exist_ok=True)
    for kind, (messages, _) in enumerate(KINDS):
        for at, message in enumerate(messages):
            (folder / f'{kind}_{at}').write_bytes(bytes([kind, at]) + serialize_message(message))


if __name__ == '__main__':
    seeds = Path(os.environ.get('FUZZ_CORPUS', 'fuzz_corpus'))
    with contextlib.suppress(FileExistsError):
        corpus(seeds)
    atheris.Setup([*sys.argv, str(seeds)], one_input)
    atheris.Fuzz()
