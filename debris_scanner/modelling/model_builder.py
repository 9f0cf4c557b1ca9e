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

"""From key frames and closures to a validated model: it is built, or looked for if it was given."""

from collections.abc import Sequence
from dataclasses import replace

from debris_scanner.core.frames import Model, TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.memory import release_memory
from debris_scanner.core.results import ERROR
from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import Faults, described
from debris_scanner.mapping.optimiser import PoseGraphSettings
from debris_scanner.modelling.build_model import BuildModel
from debris_scanner.modelling.frame_store import Restorer, spread
from debris_scanner.modelling.generation import Generation, ModelSettings, Progress
from debris_scanner.modelling.match_model import MatchModel
from debris_scanner.modelling.placement import KnownModel
from debris_scanner.modelling.scan_map import ScanMap


class ModelBuilder(ScanMap):
    """Last stage of the scanner: the map of a scan, and attempts at its model."""

    def __init__(
        self, settings: ModelSettings, graph: PoseGraphSettings, timer: StageTimer | None = None
    ) -> None:
        self.settings = settings
        self.timer = timer or StageTimer()
        self._attempts: BuildModel | MatchModel = BuildModel(self, settings, self.timer)
        kept, scale = settings.builder.kept_frames, settings.motion.information_scale
        super().__init__(kept, graph, settings.normals, scale)

    def know(self, model: Model, searched: float) -> None:
        """Look for a model, and build none.

        Args:
            model: in its own frame.
            searched: it may explain views worse than neighbours do by so much, nats a point, to be found.
        """
        self.given = True
        self._attempts = MatchModel(self, self.settings, self.timer, KnownModel(model), searched)

    @property
    def known(self) -> KnownModel | None:
        """The model that is looked for, and none is built."""
        return self._attempts.known if isinstance(self._attempts, MatchModel) else None

    def reset(self) -> None:
        """Forget the scan."""
        super().reset()
        self.last: Generation | None = None

    @property
    def has_model(self) -> bool:
        """Whether there is a model."""
        return self.last is not None and self.last.model is not None

    @property
    def should_rebuild(self) -> bool:
        """Whether an attempt is worthwhile now."""
        return self._attempts.due

    def generate(self, final: bool = False, progress: Progress | None = None) -> Generation:
        """One attempt at a model from everything so far.

        Args:
            final: refine every stored frame and fuse those, instead of the key frames alone.
            progress: called during the long steps.
        """
        self.pending = False
        self.generated_with = self._attempts.size
        progress = progress or (lambda *_: None)
        with self.timer.stage('generation'):
            generation = self._attempts.attempt(final, progress)
        release_memory()
        # during the scan a refused attempt leaves the model as it is; at its end it is the verdict
        refused = generation.model is None and not generation.withdrawn
        if final or not refused or not self.has_model:
            self.last = generation
        return generation

    def attempt(self, faults: Faults, final: bool = False, progress: Progress | None = None) -> Generation:
        """As :meth:`generate`; an attempt that raises is refused, and at the end the model so far stands."""
        restore = self.checkpoint()
        try:
            return self.generate(final, progress)
        except Exception as error:
            faults.note(error, 'an attempt at a model')
            restore()
            failed, last = f'the last attempt ended in {described(error)}', self.last
        refused = Generation(None, ERROR, failed, {}, None)
        if last is None or last.model is None:
            self.last = refused
        elif final:
            self.last = refused = replace(last, why=f'{last.why}; {failed}')
        return refused

    def tracked_frames(self, most: int) -> Sequence[tuple[TargetFrame, Array]]:
        """Some frames of a finished scan with a known model, with T_model_sensor (4, 4)."""
        stored = [f for f in self.store.with_depth if f.keyframe_ns is None]
        return Restorer(self.settings.normals).posed([stored[n] for n in spread(len(stored), most)])
