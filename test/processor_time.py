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

"""How long a call computes: what other processes do meanwhile does not count."""

import time


def processor_seconds(call, tries=3):
    """The best of some tries."""
    durations = []
    for _ in range(tries):
        start = time.process_time()
        call()
        durations.append(time.process_time() - start)
    return min(durations)
