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

"""A task in a process of its own: its value, or what happened to it; never the worker's end."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from debris_scanner.batch.isolation import Failure, Isolation, Limits

HERE = str(Path(__file__).parent)


def double(number, progress):
    progress(0.5, 'half')
    print('doubling', number)
    return 2 * number, os.getpid(), os.environ.get('OMP_NUM_THREADS'), os.environ.get('STUB')


def trim_threshold(progress):
    return os.environ.get('MALLOC_TRIM_THRESHOLD_')


def segfault(progress):
    os.kill(os.getpid(), signal.SIGSEGV)


def leave(progress):
    os._exit(3)


def raise_error(progress):
    print('before')
    raise ValueError('no\n  good')


def wait(progress):
    time.sleep(60)


def take_memory(progress):
    taken = []
    while True:
        taken.append(bytearray(b'x' * 20_000_000))
        time.sleep(0.02)


def litter(progress):
    Path('left').write_text('behind')
    return str(Path.cwd())


@pytest.fixture(scope='module')
def isolation():
    environment = {'STUB': 'set', 'PYTHONPATH': HERE}
    made = Isolation(['json', 'no_such_module'], environment)
    yield made
    made.close()


def test_a_value_comes_back_and_each_task_has_its_process(isolation, tmp_path):
    said = []
    first = isolation.run(double, (2,), tmp_path, Limits(), lambda *what: said.append(what))
    second = isolation.run(double, (3,), tmp_path, Limits())
    assert (first[0], second[0]) == (4, 6)
    assert first[1] != second[1] != os.getpid()
    assert first[2:] == ('1', 'set')
    assert said == [(0.5, 'half')]


@pytest.mark.parametrize(
    ('function', 'limits', 'kind', 'words'),
    [
        (segfault, Limits(), 'crashed', 'SIGSEGV'),
        (leave, Limits(), 'crashed', 'ended with 3'),
        (raise_error, Limits(), 'error', 'no good'),
        (wait, Limits(seconds=0.5), 'time', 'gave up after 0 s'),
        (take_memory, Limits(memory=300_000_000), 'memory', 'a task may take 300 MB'),
    ],
)
def test_what_breaks_is_said_and_the_next_task_runs(isolation, tmp_path, function, limits, kind, words):
    with pytest.raises(Failure) as caught:
        isolation.run(function, (), tmp_path, limits)
    assert caught.value.kind == kind
    assert words in str(caught.value)
    if kind == 'error':
        assert caught.value.name == 'ValueError'
        assert caught.value.log.startswith('before\nTraceback')
    assert isolation.run(double, (1,), tmp_path, Limits())[0] == 2
    assert list(tmp_path.iterdir()) == []


def test_memory_is_not_asked_for_page_by_page(monkeypatch, tmp_path):
    monkeypatch.setenv('MALLOC_TRIM_THRESHOLD_', '65536')  # as Dask sets it in its workers
    made = Isolation([], {'PYTHONPATH': HERE})
    try:
        assert made.run(trim_threshold, (), tmp_path, Limits()) is None
    finally:
        made.close()


def test_a_failure_survives_the_way_to_the_client():
    import pickle

    failure = pickle.loads(pickle.dumps(Failure('error', 'why', 'ValueError', 'log')))
    assert (failure.kind, failure.message, failure.name, failure.log) == ('error', 'why', 'ValueError', 'log')


def test_its_folder_goes_with_it(isolation, tmp_path):
    folder = isolation.run(litter, (), tmp_path, Limits())
    assert folder.startswith(str(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_a_task_is_ended_from_another_thread(isolation, tmp_path):
    timer = threading.Timer(0.5, isolation.abort)
    timer.start()
    with pytest.raises(Failure, match='interrupted') as caught:
        isolation.run(wait, (), tmp_path, Limits())
    assert caught.value.kind == 'aborted'
    timer.join()


def test_a_task_ends_with_its_worker(tmp_path):
    """kill -9 of the worker: neither the template nor the task under way stays."""
    code = (
        'import sys, pathlib, test_task_isolation\n'
        'from debris_scanner.batch.isolation import Isolation, Limits\n'
        f'Isolation([], {{}}).run(test_task_isolation.wait, (), pathlib.Path({str(tmp_path)!r}), Limits())\n'
    )
    env = {**os.environ, 'PYTHONPATH': os.pathsep.join([HERE, str(Path.cwd())])}
    worker = psutil.Process(subprocess.Popen([sys.executable, '-c', code], env=env).pid)
    end = time.monotonic() + 60
    while len(family := worker.children(recursive=True)) < 2:
        assert time.monotonic() < end
        time.sleep(0.05)
    worker.kill()
    _, alive = psutil.wait_procs(family, timeout=20)
    assert alive == []
