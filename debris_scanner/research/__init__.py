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

"""Research: the published method as it was, and the experiments of the thesis.

``thesis`` holds the method of Trowbridge 2014, step by step, with its errata corrected. It takes isolated
frames to angular rates, key frames, closures, a relaxed network and a model, beside the product's own way.

``reproduce`` runs the thesis's experiments: it simulates the recordings, runs the methods, scores them
against the truth, and draws the tables and figures. Nothing here is used by the scanner itself.
"""
