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

"""Recordings by the hundred: the same scan on every core of one machine or of a cluster.

``inputs`` finds the recordings behind folders, globs and URLs. ``engine`` runs tasks on dask.distributed: it
submits a window of them, tries again what crashed, shows progress, and accounts for every one. On a worker
(``worker``) each task runs in a process of its own (``isolation``), forked from a ``template`` that has the
libraries loaded, under limits of memory and time. For a recording that task is ``recording``: fetch to the
worker's scratch, scan, report, publish whole. ``fleet`` joins them: it leaves out what is done, and writes
``batch.csv``, ``batch.parquet`` (``tables``) and ``index.html`` (``page``).

``storage`` alone knows of fsspec, ``engine`` and ``worker`` of Dask; ``sources`` says which program a result
is of.
"""

import importlib.util

_NEEDED = ('distributed', 'fsspec', 'pyarrow')


class BatchError(Exception):
    """A batch that cannot be run or go on; the message says what to do."""


def check_installed() -> None:
    """Check that the libraries of the extra are there.

    Raises:
        BatchError: some are not; the message says what to install.
    """
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise BatchError(f"needs {', '.join(missing)}: pip install 'debris_scanner[batch]'")
