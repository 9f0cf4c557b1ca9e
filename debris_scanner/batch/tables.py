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

"""The rows of a batch as ``batch.csv`` and ``batch.parquet``: a recording a row, the same columns in both."""

import csv
from collections.abc import Mapping, Sequence
from io import BytesIO, StringIO
from typing import Any

# Column: its type. A cell without a value is empty in the one, null in the other.
COLUMNS: dict[str, type] = {
    'name': str,  # of the output folder
    'result': str,  # model, no_model, bad_input, failed, pending
    'reason': str,  # for no model, or what went wrong
    'frames_read': int,
    'frames_used': int,
    'keyframes': int,
    'closures_accepted': int,
    'rotation_period_s': float,
    'model_points': int,
    'model_triangles': int,
    'observed_share': float,
    'sensor_sigma_m': float,
    'scan_s': float,  # as in summary.json
    'fetch_s': float,
    'total_s': float,  # on the worker, with everything
    'cpu_s': float,
    'peak_rss_mb': float,
    'input_bytes': int,
    'output_bytes': int,
    'attempts': int,
    'worker': str,
    'finished': str,  # UTC, ISO 8601
    'version': str,
    'program': str,  # digest of sources and libraries
    'input_sha256': str,
    'parameters_sha256': str,
    'url': str,
}


def csv_bytes(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Comma-separated, UTF-8, with a header."""
    text = StringIO()
    writer = csv.DictWriter(text, list(COLUMNS), extrasaction='ignore', lineterminator='\n')
    writer.writeheader()
    for row in rows:
        writer.writerow({name: '' if row.get(name) is None else row[name] for name in COLUMNS})
    return text.getvalue().encode()


def parquet_bytes(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Apache Parquet with the types of ``COLUMNS``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    arrays = [
        pa.array([None if row.get(name) is None else kind(row[name]) for row in rows], kinds[kind])
        for name, kind in COLUMNS.items()
    ]
    buffer = BytesIO()
    pq.write_table(pa.table(arrays, names=list(COLUMNS)), buffer)
    return buffer.getvalue()
