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

"""Damaged messages and bags, degenerate scans, or scans of odd targets; from the repository:

    .venv/bin/python test/fuzz/run_fuzz.py --cases 100000             ten minutes on one core
    .venv/bin/python test/fuzz/run_fuzz.py --of scans --cases 100000  some hours
    .venv/bin/python test/fuzz/run_fuzz.py --of targets --cases 300   some hours

Each case is named by its number and the seed: the same again with ``--only N``. What must not happen: an
exception that is no MalformedMessage, BagError or FrameRejected (of a scan: any), a crash of the process, a
case that takes too long, or more memory than a few hundred MB. Blocks of cases are tasks of the batch
engine, in processes of their own, so a crash costs only its case.
"""

import argparse
import contextlib
import io
import mmap
import os
import resource
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

HERE = Path(__file__).resolve().parent
PATHS = [str(HERE), str(HERE.parents[1]), str(HERE.parent / 'msg_adapters')]  # sessions.py is there
sys.path += PATHS

GROWTH_MB = {'messages': 400, 'scans': 400, 'targets': 3000}
EVERY = 10  # one in so many is a bag; they cost more


@dataclass(frozen=True)
class Bounds:
    """How long a case may take, and is waited for; and how many a task has."""

    slow_s: float
    hang_s: float
    block: int


BOUNDS = {
    'messages': Bounds(5.0, 60.0, 5000),
    'scans': Bounds(120.0, 300.0, 100),  # a merge takes half a minute
    'targets': Bounds(600.0, 1800.0, 5),
}


def case(number: int, seed: int, of: str = 'messages') -> tuple[str, Callable[[Random], object], Random]:
    """Name, what to run, and the randomness of a case."""
    if of == 'scans':
        from degenerate_scans import KINDS, run_case

        kind = KINDS[number % len(KINDS)]
        return kind, partial(run_case, kind), Random(f'{seed}/{number}')
    if of == 'targets':
        import odd_targets

        kind = odd_targets.KINDS[number % len(odd_targets.KINDS)]
        return kind, partial(odd_targets.run_case, kind), Random(f'{seed}/{number}')
    from bag_cases import run_bag
    from message_cases import run_bytes, run_fields

    if number % EVERY == 0:
        kind, run = 'bag', run_bag
    else:
        kind, run = ('fields', run_fields) if number % 2 else ('bytes', run_bytes)
    return kind, run, Random(f'{seed}/{number}')


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def work(first: int, last: int, seed: int, note: Path, of: str = 'messages') -> int:
    """Run cases in this process, count the failures, and note which one it is, should the process die."""
    import faulthandler

    bounds = BOUNDS[of]
    if of == 'messages':
        from bag_cases import bags
        from message_cases import seeds

        seeds(), bags()
    for number in () if of == 'targets' else (0, 1, 2):  # what is compiled and cached on first use is no leak
        _, run, random = case(number, -1, of)
        run(random)
    start_mb, failures = peak_mb(), 0
    with note.open('r+b') as file, mmap.mmap(file.fileno(), 8) as here:
        for number in range(first, last):
            here[:] = struct.pack('<q', number)
            kind, run, random = case(number, seed, of)
            before_mb, start = peak_mb(), time.perf_counter()
            faulthandler.dump_traceback_later(bounds.hang_s, exit=True, file=sys.__stderr__)
            try:
                run(random)
            except Exception:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed}:\n{traceback.format_exc()[-3000:]}', flush=True)
            if (took := time.perf_counter() - start) > bounds.slow_s:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed} took {took:.1f} s', flush=True)
            if (grown := peak_mb() - before_mb) > GROWTH_MB[of]:
                failures += 1
                print(f'case {number} ({kind}) of seed {seed} took {grown:.0f} MB', flush=True)
        faulthandler.cancel_dump_traceback_later()
    print(f'  {first} to {last}: peak {peak_mb():.0f} MB, {peak_mb() - start_mb:+.0f} MB', flush=True)
    return failures


def block(
    first: int, last: int, seed: int, note: Path, of: str, progress: Callable[[float, str], None]
) -> tuple[int, str]:
    """Body of a task: what it prints is in its log, and told only if it dies."""
    sys.path[:0] = [p for p in PATHS if p not in sys.path]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        failures = work(first, last, seed, note, of)
    progress(1.0, f'{first} to {last}')
    return failures, said.getvalue()


def supervise(cases: int, seed: int, first: int, of: str, jobs: int = 1, scheduler: str | None = None) -> int:
    """All cases, a block a task; the number of failures."""
    from debris_scanner.batch.engine import Cluster, Engine
    from debris_scanner.batch.worker import Outcome, Task

    failures, start, size = 0, time.monotonic(), BOUNDS[of].block
    with tempfile.TemporaryDirectory() as folder, Engine(Cluster(jobs, scheduler)) as engine:

        def task(begin: int, end: int) -> Task:
            note = Path(folder, f'{begin}_{end}')
            note.write_bytes(struct.pack('<q', begin))
            return Task(note.name, block, (begin, end, seed, note, of), weight=end - begin)

        end = first + cases
        todo = [task(k, min(k + size, end)) for k in range(first, end, size)]
        while todo:
            crashed: list[Task] = []

            def account(outcome: Outcome) -> None:
                nonlocal failures
                if outcome.failure is None:
                    found, said = outcome.value
                    failures += found
                    print(said, end='', flush=True)
                    return
                (fatal,) = struct.unpack('<q', Path(folder, outcome.key).read_bytes())
                failures += 1
                told = f'{outcome.failure}:\n{outcome.failure.log[-3000:]}'
                print(f'case {fatal} of seed {seed} ended the process ({told})', flush=True)
                last = int(outcome.key.split('_')[1])
                if fatal + 1 < last:
                    crashed.append(task(fatal + 1, last))

            engine.run(todo, account, title='fuzz', unit='case')
            todo = crashed
    kinds = Counter(case(k, seed, of)[0] for k in range(first, first + cases))
    words = ', '.join(f'{n} {kind}' for kind, n in sorted(kinds.items()))
    print(f'{cases} cases ({words}) of seed {seed} in {time.monotonic() - start:.0f} s: {failures} failures')
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--of', choices=tuple(BOUNDS), default='messages', help='what is damaged (messages)')
    parser.add_argument('--cases', type=int, default=100_000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--only', type=int, metavar='N', help='run one case here, with its traceback')
    parser.add_argument('--jobs', type=int, default=1, metavar='N', help='blocks of cases at a time (1)')
    parser.add_argument('--scheduler', metavar='ADDRESS', help='of a Dask cluster that shares this disk')
    args = parser.parse_args()
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    if args.only is not None:
        _, run, random = case(args.only, args.seed, args.of)
        run(random)
        return 0
    failures = supervise(args.cases, args.seed, args.first, args.of, args.jobs, args.scheduler)
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
