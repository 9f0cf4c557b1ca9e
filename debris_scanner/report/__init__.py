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

"""The report: one HTML page about a finished scan. Reads files, never runs a scan.

1. `scan_output` reads the result folder; `truth` aligns the true poses, where there are any.
2. The plot modules make figures: `time_plots` (rate, drift, timing), `space_plots` (model, sensor track),
   `similarity_plots` and `discrimination_plots` (likeness of key frames), `graph_plots` (pose graph).
   `style` gives them one look; `discrimination` computes entropy and ROC. `frame_view` holds the pose of
   every frame, which a slider on the page shows as the sensor saw it.
3. `fragments` and `explanations` write the verdict, figures and tables in words.
4. `page` puts all into one file that needs no network.
"""
