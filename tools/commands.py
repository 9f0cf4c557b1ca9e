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

"""``python -m tools.commands BIN``: what README and tutorial print, run in an empty folder.

BIN is the folder of an environment's programs, as ``venv/bin``. Each ``debris-scan`` command runs as it is
printed, in the order of the pages. Where it names a folder of the reader's, a simulated one lies there. Where
it waits for a camera, it has to say so, and to end by Ctrl-C.
"""

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from debris_scanner.sim.session import Simulation, SimulationSettings
from tools.dist import ROOT

PAGES = ('docs/tutorial.md', 'README.md')
WAITS_S = 60.0  # for the word of a scan that waits for a camera
ENDS_S = 60.0  # after Ctrl-C
# what an empty environment does not have, and where it is tried
ELSEWHERE = {
    'make': 'CI',
    'pip': 'the check "stranger"',
    'colcon': 'test/nodes/test_real_launch.py',
    'ros2': 'test/nodes/test_real_launch.py',
}
# what the reader has where README says so: results of the tutorial
LIES_THERE = {
    'BAG': 'box',
    'recordings/': 'box',
    'out/scan': 'out/box',
    'out/upright': 'out/box',
    'out/on_its_side': 'out/box_on_its_side',
}
MAY_REFUSE = {'merge'}  # a box looks the same from several sides; the tutorial says so


class CommandFailed(Exception):
    """A printed command did not do what the page says."""


def printed(page: Path) -> Iterator[list[str]]:
    """The words of each command that a page shows on an indented line, or several joined by ``&&``."""
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for line in re.findall(r'^ {4}(?:\.venv/bin/)?(\S.*)$', text, re.MULTILINE):
        for command in line.split(' && '):
            if words := shlex.split(command, comments=True):
                yield words


def waits(words: list[str]) -> bool:
    """Whether a command waits for a camera."""
    return words[1] == 'live' and '--bag' not in words


def provide(words: list[str], folder: Path) -> None:
    """Put what a command reads where it looks for it, and take away what it would have to overwrite.

    Args:
        words: of the command.
        folder: that it runs in; the tutorial's results lie there.
    """
    result = words[words.index('--out') + 1] if '--out' in words else None
    if result is not None and words[1] in ('simulate', 'import'):
        shutil.rmtree(folder / result, ignore_errors=True)
    for name in words[2:]:
        place = folder / name
        if name == result or place.exists():
            continue
        if name in LIES_THERE:
            shutil.copytree(folder / LIES_THERE[name], place / 'first' if name.endswith('/') else place)
        elif name == 'FOLDER':
            _depth_images(place)


def _depth_images(folder: Path) -> None:
    """Depth images in millimetres and their camera, as `import` reads them."""
    (folder / 'depth').mkdir(parents=True)
    for frame in Simulation(SimulationSettings(target='cubesat', seconds=3.0)):
        millimetres = np.rint(frame.depth * 1000).astype(np.uint16)
        Image.fromarray(millimetres).save(folder / 'depth' / f'{frame.stamp_ns / 1e9:.3f}.png')
    c = frame.camera
    np.savetxt(folder / 'Intrinsic.txt', np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]))


def run(words: list[str], programs: Path, folder: Path) -> str:
    """Run a command; what came of it, in a word.

    Args:
        words: of the command.
        programs: folder of the environment's programs.
        folder: to run in.

    Raises:
        CommandFailed: with the end of what it printed.
    """
    if words[0] != 'debris-scan':
        if words[0] in ELSEWHERE:
            return f'tried by {ELSEWHERE[words[0]]}'
        raise CommandFailed(f'nobody tries {words[0]}')
    provide(words, folder)
    named = ('PYTHONPATH', 'AMENT_PREFIX_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'DISPLAY')
    environment = {n: v for n, v in os.environ.items() if n not in named}
    environment['PATH'] = f'{programs}{os.pathsep}{environment["PATH"]}'
    log = folder / 'command.log'
    with log.open('w') as output:
        process = subprocess.Popen(
            [programs / words[0], *words[1:]], cwd=folder, env=environment, stdout=output, stderr=output,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        said = _ended_by_hand(process, log) if waits(words) else _ended(process)
    text = log.read_text()
    allowed = {0, 3} if waits(words) or words[1] in MAY_REFUSE else {0}
    if process.returncode not in allowed or 'Traceback' in text:
        raise CommandFailed(f'exit code {process.returncode}: {shlex.join(words)}\n{text[-2000:]}')
    return said


def _ended(process: subprocess.Popen[bytes]) -> str:
    start = time.monotonic()
    code = process.wait()
    return f'exit code {code} after {time.monotonic() - start:.0f} s'


def _ended_by_hand(process: subprocess.Popen[bytes], log: Path) -> str:
    """Wait until a scan says that it waits for frames, and press Ctrl-C."""
    start = time.monotonic()
    while process.poll() is None and time.monotonic() - start < WAITS_S:
        time.sleep(0.5)
        if 'no frames yet' in log.read_text():
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                return f'waits for a camera; exit code {process.wait(ENDS_S)} after Ctrl-C'
            break
    process.kill()
    process.wait()
    raise CommandFailed(f'did not wait for a camera, or not end by Ctrl-C:\n{log.read_text()[-2000:]}')


def main() -> int:
    """Run all commands of the pages; 1 where one fails."""
    if len(sys.argv) != 2 or not Path(sys.argv[1], 'debris-scan').exists():
        print('usage: python -m tools.commands BIN, where BIN holds debris-scan', file=sys.stderr)
        return 2
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        for page in PAGES:
            print(page)
            for words in printed(ROOT / page):
                print(f'  {shlex.join(words)}: ', end='', flush=True)
                try:
                    print(run(words, Path(sys.argv[1]).resolve(), Path(name)), flush=True)
                except CommandFailed as why:
                    failed += 1
                    print(f'FAILED\n{why}', flush=True)
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
