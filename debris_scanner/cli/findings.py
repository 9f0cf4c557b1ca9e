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

"""What doctor finds, and how it asks: in a process of its own, for what is broken may end it."""

import re
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata

OK, WARN, FAIL = 'OK', 'WARN', 'FAIL'


@dataclass(frozen=True)
class Finding:
    """One line of the report; ``advice`` says what to do unless all is well."""

    status: str
    subject: str
    text: str
    advice: str = ''


def ask_python(code: str, timeout_s: float = 60) -> tuple[str | None, str]:
    """Last line that ``code`` prints in a fresh interpreter, or None and why it failed."""
    try:
        done = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None, f'no answer within {timeout_s:.0f} s'
    if done.returncode:
        lines = [re.sub(r'\s+', ' ', line) for line in done.stderr.splitlines() if line.strip()]
        return None, lines[-1][:200] if lines else f'ended with code {done.returncode}'
    return (done.stdout.strip().splitlines() or [''])[-1], ''


def version_of(distribution: str) -> str | None:
    """Version of an installed distribution."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None
