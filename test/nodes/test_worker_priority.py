"""A worker that steps back leaves the rest of its process as it is."""

import os
import sys
import threading

import pytest

from debris_scanner.nodes.worker import Worker


@pytest.mark.skipif(sys.platform != 'linux', reason='threads of other systems have no niceness of their own')
def test_only_the_worker_is_nice():
    before = os.getpriority(os.PRIO_PROCESS, 0)
    if before > 14:
        pytest.skip('too nice already to become nicer')
    found = []
    worker = Worker(lambda: None, nice=before + 5)
    worker.post(lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    worker.start()
    worker.stop()
    worker.check()
    assert found == [before + 5]
    assert os.getpriority(os.PRIO_PROCESS, 0) == before
