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

"""Results on disk: one complete JSON for each case, keyed by its options and the digest of the sources."""

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

from benchmarks.scorecard.cases import Case
from debris_scanner.batch import sources
from debris_scanner.io.files import write_atomically

RECORD = 5  # version of a record's content
PACKAGES = ('debris_scanner', 'benchmarks', 'msg_adapters')  # that a case imports


def digest(root: Path = sources.ROOT) -> str:
    """Short digest of the sources that decide a result: algorithms and simulator."""
    return sources.digest(root, str(RECORD))


class Store:
    """The output folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / 'cases'
        self.folder.mkdir(parents=True, exist_ok=True)

    def save(self, case: Case, record: dict[str, Any], source: str) -> None:
        """Write the record of a case."""
        content = {'case': case.name, 'key': case.key, 'source': source, **record}
        text = json.dumps(content, indent=1, allow_nan=False)
        write_atomically(self._path(case), (text + '\n').encode())

    def load(self, case: Case, source: str | None = None) -> dict[str, Any] | None:
        """The record of a case; None if there is none, or one of other options or another source.

        Args:
            case: whose record.
            source: digest that it must have, None for any.
        """
        try:
            record = json.loads(self._path(case).read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        if not isinstance(record, dict) or record.get('key') != case.key:
            return None
        return record if source is None or record.get('source') == source else None

    def done(self, case: Case, source: str | None, extras: Collection[str] = ()) -> bool:
        """Whether nothing is left to do; a case that broke is tried again."""
        record = self.load(case, source)
        return record is not None and 'error' not in record and set(extras) <= set(record.get('extras', ()))

    def _path(self, case: Case) -> Path:
        return self.folder / f'{case.name}.json'
