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

"""The ``debris-scan`` command: ``main`` finds the verb, and each verb is a module (``live``: a folder).

A verb has ``add_arguments(parser)`` and ``run(args)``, which returns the exit code. Its module is imported
only when the verb runs, and imports heavy libraries inside functions, so that help and errors appear at once.

Verbs share ``errors`` (exit codes) and ``outcome`` (the table at the end).
``dds_probe`` is the round trip that ``doctor`` measures.
"""
