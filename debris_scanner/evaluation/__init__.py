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

"""A finished scan compared with the truth. Nothing here takes part in a scan.

1. `metrics.evaluate` reads a result folder and the truth beside the recording.
2. `trajectory_errors` aligns the estimated poses with the true ones by one constant transform. It measures
   pose errors and the odometry's drift.
3. `closure_scores` gives precision and recall of the closures, by the poses that were registered.
4. `true_surface` measures distances to the true surface and records which parts of it were seen.
5. `metrics` gives the figures and the verdict: right or wrong, and why.

`truth_cloud` makes a true surface from depth frames with measured poses, where no mesh exists.
"""

from debris_scanner.evaluation.metrics import EvaluationError, evaluate
from debris_scanner.evaluation.true_surface import TrueSurface

__all__ = ['EvaluationError', 'TrueSurface', 'evaluate']
