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

"""Experiments in processes of their own, so many at a time, with one progress bar for all."""

import multiprocessing
import os
import queue
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from debris_scanner.research.reproduce.experiments import EXPERIMENTS
from debris_scanner.research.reproduce.run import run

_POLL_S = 0.2
_GRACE_S = 3.0


class ReproduceError(Exception):
    """An experiment that came to no result; the message says which and why."""


def run_experiments(keys: Sequence[str], out: Path, quick: bool, jobs: int) -> None:
    """Run the experiments of these keys; each leaves its folder in ``out`` when it is done.

    One that fails does not stop the others, which are of use when the failed one is tried again.

    Raises:
        ReproduceError: at least one experiment failed.
    """
    # spawned, not forked: threads of the libraries do not survive a fork
    context = multiprocessing.get_context('spawn')
    news: Any = context.Queue()
    waiting = list(keys)
    running: dict[str, Any] = {}
    failed: dict[str, str] = {}
    shares = dict.fromkeys(keys, 0.0)
    with tqdm(total=100 * len(keys), desc='reproduce', unit='%', disable=None) as bar:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    key = waiting.pop(0)
                    process = context.Process(target=_work, args=(key, out, quick, news), daemon=True)
                    process.start()
                    running[key] = process
                _listen(news, shares, failed, bar)
                for key in [k for k, p in running.items() if not p.is_alive()]:
                    process = running.pop(key)
                    process.join()
                    if process.exitcode:
                        failed.setdefault(key, f'its process ended with {process.exitcode}')
            _listen(news, shares, failed, bar)
        finally:
            for process in running.values():
                end(process)
    if failed:
        raise ReproduceError('; '.join(f'experiment {k}: {why}' for k, why in sorted(failed.items())))


def end(process: Any) -> None:
    """End a process, by force if it does not go when asked: one that is stopped cannot."""
    process.terminate()
    process.join(_GRACE_S)
    if process.is_alive():
        process.kill()
        process.join()


def _listen(news: Any, shares: dict[str, float], failed: dict[str, str], bar: 'tqdm[Any]') -> None:
    try:
        key, share, text = news.get(timeout=_POLL_S)
    except queue.Empty:
        return
    while True:
        if share is None:
            failed[key] = text
        else:
            shares[key] = max(shares[key], share)
            bar.set_postfix_str(f'{key}: {text}', refresh=False)
        try:
            key, share, text = news.get_nowait()
        except queue.Empty:
            break
    bar.update(round(100 * sum(shares.values())) - bar.n)


def _work(key: str, out: Path, quick: bool, news: Any) -> None:
    """Body of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted too, and ends us
    _one_thread_each()
    try:
        run(EXPERIMENTS[key], out, quick, lambda share, text: news.put((key, share, text)))
    except (ValueError, OSError) as error:
        news.put((key, None, ' '.join(str(error).split()) or type(error).__name__))


def _one_thread_each() -> None:
    """Libraries that look at it do not fight the other process for its core."""
    os.environ.setdefault('OMP_NUM_THREADS', '1')
