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

"""Cases as tasks of the batch engine: each in a process of its own, all by one version of the sources."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.scorecard.cases import Case
from benchmarks.scorecard.targets import data_folder
from debris_scanner.batch.engine import Cluster, Engine, Surroundings, say
from debris_scanner.batch.isolation import Failure
from debris_scanner.batch.sources import archive
from debris_scanner.batch.template import Progress
from debris_scanner.batch.worker import Outcome, Task

_REPORT_EVERY = 20  # frames
PRELOAD = ('benchmarks.scorecard.run_case', 'debris_scanner.core.open3d_library:load_open3d')

Record = dict[str, Any]


def run_cases(
    cases: Sequence[Case],
    jobs: int,
    sources: Path,
    extras: Sequence[str],
    limit_s: float,
    on_result: Callable[[Case, Record], None],
    scheduler: str | None = None,
) -> None:
    """Run all cases; every one ends in a call of ``on_result``, with its figures or with its error.

    Args:
        cases: to run, in this order.
        jobs: processes at a time.
        sources: root of the sources that the processes import.
        extras: see ``run_case``.
        limit_s: a case that takes longer is given up.
        on_result: called in this process.
        scheduler: address of a cluster in place of processes on this machine; the sources are sent to it.

    Raises:
        BatchError: the cluster cannot be reached, or was lost.
        KeyboardInterrupt: all processes are ended then; finished cases have been passed on.
    """
    if not cases:
        return
    by_name = {case.name: case for case in cases}
    tasks = [Task(c.name, work, (c, tuple(extras)), max(c.frames, 1)) for c in cases]

    def account(outcome: Outcome) -> None:
        record = outcome.value if outcome.failure is None else {'error': _told(outcome.failure)}
        on_result(by_name[outcome.key], record)

    with Engine(Cluster(workers=jobs, scheduler=scheduler), say) as engine:
        engine.run(
            tasks,
            account,
            title='scorecard',
            unit='frame',
            inside=Surroundings(
                preload=PRELOAD,
                variables={'DEBRIS_SCANNER_DATA': str(data_folder())},
                sources=sources,
                archive=None if scheduler is None else archive(sources),
                seconds=limit_s,
            ),
        )


def work(case: Case, extras: Sequence[str], progress: Progress) -> Record:
    """One case, in its process."""
    # here and not above: sources that do not even import are an error like others
    from benchmarks.scorecard.run_case import run_case

    def report(frames: int) -> None:
        if frames % _REPORT_EVERY == 0:
            progress(min(frames / max(case.frames, 1), 1.0), case.name)

    return run_case(case, extras, report)


def _told(failure: Failure) -> str:
    """The traceback where there is one."""
    return failure.log if failure.kind == 'error' and failure.log else str(failure)
