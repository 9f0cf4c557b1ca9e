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

"""Damaged messages and bags by the hundred thousand; from the repository, in some ten minutes on one core:

    .venv/bin/python test/fuzz/run_fuzz.py --cases 100000

Each case is named by its number and the seed: the same again with ``--only N``. What must not happen: an
exception that is no MalformedMessage, BagError or FrameRejected, a crash of the process, a case of more
than a few seconds, or more memory than a few hundred MB. Cases run in processes of their own, so a crash
costs only its case.
"""

import argparse
import mmap
import os
import resource
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parents[1]), str(HERE.parent / 'msg_adapters')]  # sessions.py is there

SLOW_S = 5.0
HANG_S = 60
GROWTH_MB = 400
BLOCK = 5000
EVERY = 10  # one in so many is a bag; they cost more
FAILED = 10  # exit code of a worker that got to its end; any other is a crash, 1 a hang


def case(number: int, seed: int) -> tuple[str, Callable[[Random], None], Random]:
    """Name, what to run, and the randomness of a case."""
    from bag_cases import run_bag
    from message_cases import run_bytes, run_fields

    if number % EVERY == 0:
        kind, run = 'bag', run_bag
    else:
        kind, run = ('fields', run_fields) if number % 2 else ('bytes', run_bytes)
    return kind, run, Random(f'{seed}/{number}')


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def work(first: int, last: int, seed: int, note: Path) -> int:
    """Run cases in this process; notes which one, for whoever finds the process dead."""
    import faulthandler

    from bag_cases import bags
    from message_cases import seeds

    seeds(), bags()
    for number in (0, 1, 2):  # what is compiled and cached on first use is no leak
        _, run, random = case(number, -1)
        run(random)
    start_mb, failures = peak_mb(), 0
    with note.open('r+b') as file, mmap.mmap(file.fileno(), 8) as here:
        for number in range(first, last):
            here[:] = struct.pack('<q', number)
            kind, run, random = case(number, seed)
            before_mb, start = peak_mb(), time.perf_counter()
            faulthandler.dump_traceback_later(HANG_S, exit=True, file=sys.__stderr__)
            try:
                run(random)
            except Exception:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed}:\n{traceback.format_exc()[-3000:]}', flush=True)
            if (took := time.perf_counter() - start) > SLOW_S:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed} took {took:.1f} s', flush=True)
            if (grown := peak_mb() - before_mb) > GROWTH_MB:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed} took {grown:.0f} MB', flush=True)
        faulthandler.cancel_dump_traceback_later()
    print(f'  {first} to {last}: peak {peak_mb():.0f} MB, {peak_mb() - start_mb:+.0f} MB', flush=True)
    note.write_bytes(struct.pack('<q', failures))
    return FAILED if failures else 0


def supervise(cases: int, seed: int, first: int) -> int:
    """All cases, a block a process; the number of failures."""
    failures, start, number = 0, time.monotonic(), first
    with tempfile.TemporaryDirectory() as folder:
        note = Path(folder, 'case')
        note.write_bytes(bytes(8))
        while number < first + cases:
            last = min(number + BLOCK, first + cases)
            command = [
                sys.executable,
                __file__,
                '--work',
                str(number),
                str(last),
                str(note),
                '--seed',
                str(seed),
            ]
            # what the middleware's parsers print of each damaged message goes nowhere
            done = subprocess.run(command, stderr=subprocess.PIPE, text=True, errors='replace', check=False)
            (said,) = struct.unpack('<q', note.read_bytes())
            if done.returncode in (0, FAILED):
                failures, number = failures + said, last
                continue
            fatal = said
            print(
                f'case {fatal} of seed {seed} ended the process ({done.returncode}):\n{done.stderr[-3000:]}'
            )
            failures, number = failures + 1, fatal + 1
    kinds = Counter(case(k, seed)[0] for k in range(first, first + cases))
    words = ', '.join(f'{n} {kind}' for kind, n in sorted(kinds.items()))
    print(f'{cases} cases ({words}) of seed {seed} in {time.monotonic() - start:.0f} s: {failures} failures')
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--cases', type=int, default=100_000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--only', type=int, metavar='N', help='run one case here, with its traceback')
    parser.add_argument('--work', nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    if args.only is not None:
        _, run, random = case(args.only, args.seed)
        run(random)
        return 0
    if args.work:
        first, last, note = args.work
        return work(int(first), int(last), args.seed, Path(note))
    return 1 if supervise(args.cases, args.seed, args.first) else 0


if __name__ == '__main__':
    sys.exit(main())
