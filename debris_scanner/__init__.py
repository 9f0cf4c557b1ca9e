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

"""Watch a rotating object with a depth sensor, close the loop, build its model, track it."""

import os

from debris_scanner.kernel_cache import choose_cache

# Our matrices are small: further threads of linear algebra only wait for each other, busily, and take a
# quarter of all time from what is live. Heeded where numpy was not imported before.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
choose_cache()  # before numba is imported

__version__ = '1.0.0'
