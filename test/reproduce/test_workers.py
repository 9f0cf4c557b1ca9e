"""Processes end when they are told to, whatever state they are in."""

import multiprocessing
import os
import signal
import time

import pytest

from debris_scanner.reproduce import workers


@pytest.mark.parametrize('stopped', [False, True])
def test_a_worker_can_be_ended(stopped, monkeypatch):
    monkeypatch.setattr(workers, '_GRACE_S', 0.3)
    process = multiprocessing.get_context('spawn').Process(target=time.sleep, args=(60,), daemon=True)
    process.start()
    if stopped:
        os.kill(process.pid, signal.SIGSTOP)
    workers.end(process)
    assert not process.is_alive()
    # of two pending signals the kernel may deliver either
    assert process.exitcode in ((-signal.SIGKILL, -signal.SIGTERM) if stopped else (-signal.SIGTERM,))
