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

"""Experiments as tasks of the batch engine: so many at a time, each in a process of its own."""

from collections.abc import Sequence
from pathlib import Path

from debris_scanner.batch.engine import Cluster, Engine, Surroundings
from debris_scanner.batch.template import Progress
from debris_scanner.batch.worker import Outcome, Task
from debris_scanner.research.reproduce.experiments import EXPERIMENTS
from debris_scanner.research.reproduce.run import run

PRELOAD = ('debris_scanner.research.reproduce.run', 'debris_scanner.core.open3d_library:load_open3d')


class ReproduceError(Exception):
    """An experiment that came to no result; the message says which and why."""


def run_experiments(keys: Sequence[str], out: Path, quick: bool, jobs: int) -> None:
    """Run the experiments of these keys; each leaves its folder in ``out`` when it is done.

    One that fails does not stop the others, which are of use when the failed one is tried again.

    Raises:
        ReproduceError: at least one experiment failed.
        BatchError: the libraries of the engine are missing.
    """
    if not keys:
        return
    failed: dict[str, str] = {}

    def account(outcome: Outcome) -> None:
        if outcome.failure is not None:
            failed[outcome.key] = str(outcome.failure)

    tasks = [Task(key, experiment, (key, out.resolve(), quick), weight=100) for key in keys]
    with Engine(Cluster(workers=min(jobs, len(keys)))) as engine:
        engine.run(tasks, account, title='reproduce', unit='%', inside=Surroundings(PRELOAD))
    if failed:
        raise ReproduceError('; '.join(f'experiment {k}: {why}' for k, why in sorted(failed.items())))


def experiment(key: str, out: Path, quick: bool, progress: Progress) -> None:
    """One experiment, in its process."""
    run(EXPERIMENTS[key], out, quick, progress)
