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

"""Closure search among ever more key frames: one comparison with all, and the whole search."""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.performance.measure import Row, repeat
from benchmarks.performance.ours import OURS, SETTINGS
from benchmarks.performance.scene import Shot
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.mapping.closure_search import attitude_probability, candidates, joint_probability
from debris_scanner.mapping.descriptors import (
    SIZE,
    PerBinThreshold,
    binary_similarity,
    efpfh,
    float_similarity,
    hamming,
)

COUNTS = (100, 1_000, 10_000)


def search(shots: list[Shot], times: int) -> list[Row]:
    """Rows ``float`` and ``binary``, comparisons alone, and ``search``, up to the ranked candidates."""
    rows = []
    for count in COUNTS:
        descriptors, histograms = _described(shots, count)
        rotations = np.array([inverse(shots[k % len(shots)].pose)[:3, :3] for k in range(count)])
        stamps, paths = np.arange(count, dtype=np.int64), np.linspace(0.0, 0.1 * count, count)

        def search_all(
            descriptors: PerBinThreshold = descriptors, rotations: Array = rotations,
            stamps: Array = stamps, paths: Array = paths,
        ) -> None:  # fmt: skip
            similarity = binary_similarity(descriptors.hamming_to_earlier(len(descriptors) - 1))
            attitude = attitude_probability(rotations[0], rotations[1:])
            probability = joint_probability(similarity, attitude)
            candidates(stamps[1:], probability, paths[1:], float(paths[-1]), SETTINGS.closure_search, most=2)

        tasks: dict[str, Callable[[], object]] = {
            'float EFPFH': partial(float_similarity, histograms[0], histograms),
            'binary EFPFH': partial(hamming, descriptors.words[0], descriptors.words),
            'closure search': search_all,
        }
        rows += [
            Row(f'{name}, 1 against {count}', OURS, repeat(task, times, 5)) for name, task in tasks.items()
        ]
    return rows


def _described(shots: list[Shot], count: int) -> tuple[PerBinThreshold, Array]:
    """Descriptors of so many key frames: those of the shots, each a little different every time."""
    random = np.random.default_rng(0)
    real = np.array([efpfh(s.view.points, s.view.normals) for s in shots])
    noise = random.normal(1.0, 0.1, (count, SIZE)).clip(0.5, 1.5)
    histograms = (real[np.arange(count) % len(real)] * noise).astype(np.float32)
    histograms /= histograms.sum(axis=1, keepdims=True)
    descriptors = PerBinThreshold()
    for histogram in histograms:
        descriptors.add(histogram)
    return descriptors, histograms
