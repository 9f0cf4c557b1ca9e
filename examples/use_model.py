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

"""Open the model of a scan in Open3D and trimesh: ``python examples/use_model.py OUT [PICTURE]``."""

import sys
from pathlib import Path

import numpy as np

from debris_scanner.core.frames import Model
from debris_scanner.io.known_models import read_known_model


def main(scan: Path) -> Model:
    """Measure the model of a saved scan; ``result.model`` is the same right after it."""
    model = read_known_model(scan)
    mesh = model.to_trimesh()
    print(f'{len(mesh.faces)} triangles, {mesh.area * 1e4:.0f} cm2, {mesh.extents.max():.3f} m across')
    mesh.export(scan / 'seen.stl')
    shown = model.to_open3d()
    print(f'Open3D: {shown}, centre {np.round(shown.get_center(), 4)}')
    return model


if __name__ == '__main__':
    main(Path(sys.argv[1]))
