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

"""Scans of one object become one model.

A later scan's model is looked at from all sides, as a sensor would see it; these views are placed on the
first model without a prior, as those of a scan with a known model are. What only one of the two shows is no
evidence. Then all models are fused from such views, and closed.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import KeyFrame, LazyFrames, Model, Posed
from debris_scanner.core.geometry import Array, compose, inverse, sphere_directions, transform
from debris_scanner.core.results import AMBIGUOUS, NO_OVERLAP, Checks
from debris_scanner.modelling.closing import close
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.placement import (
    FEWEST_PIXELS,
    KnownModel,
    MatchSettings,
    Search,
    find_model,
    overlap_loss,
)
from debris_scanner.modelling.refinement import CLOUD_SPACING, integrated, large_parts, make_model
from debris_scanner.sensing.silhouette import MARGIN_PX
from debris_scanner.sensing.views import View

SEARCH_VIEWS, SEARCH_PIXELS = 14, 240  # directions, and pixels across the model
CANDIDATES, GLANCED = 3, 4  # of each view; views that tell which of them are likely
FUSED_VIEWS, MOST_PIXELS = 80, 500
AWAY = 4.4  # radii, from which a model is looked at
LEAST_OVERLAP = 0.2  # of what a model shows of itself

Progress = Callable[[str, int, int], None]  # what, done, of how many


@dataclass(frozen=True)
class Merged:
    """The model of all scans, in the first one's frame; ``T_first_scan`` (4, 4) of each scan placed so far.

    ``reason`` is None, ``no_overlap`` or ``ambiguous``; ``why`` has the numbers.
    """

    model: Model | None
    reason: str | None
    why: str
    T_first_scan: list[Array]
    checks: Checks = ()  # of the scan that was refused, or of all


def merge(
    models: Sequence[Model],
    settings: FusionSettings,
    bounds: MatchSettings,
    progress: Progress = lambda *_: None,
) -> Merged:
    """Place models on the first one, one after the other, and fuse them.

    A model that has nothing in common with the first may have with one that was placed before: it is tried
    against each of those.

    Args:
        models: at least two, each in its own frame.
        settings: of the fusion.
        bounds: of a match.
        progress: called during the long steps.
    """
    known = [KnownModel(m) for m in models]
    for k, one in enumerate(known):
        if not len(looks(one, SEARCH_VIEWS, SEARCH_PIXELS)):
            return Merged(None, NO_OVERLAP, f'scan {k + 1}: it shows no surface', [np.eye(4)])
    placed: dict[int, Array] = {0: np.eye(4)}
    waiting, refusals = list(range(1, len(models))), dict[int, tuple[str, str, Checks]]()
    while waiting:
        found = None
        for k in waiting:
            for base in placed:
                T, refusals[k] = _place(known[base], known[k], bounds)
                if T is not None:
                    found = k, compose(placed[base], T)
                    break
            if found is not None:
                break
        if found is None:
            reason, why, checks = refusals[waiting[0]]
            return Merged(None, reason, f'scan {waiting[0] + 1}: {why}', list(placed.values()), checks)
        placed[found[0]] = found[1]
        waiting.remove(found[0])
        progress('place', len(placed) - 1, len(models) - 1)
    poses = [placed[k] for k in range(len(models))]
    why = '; '.join(refusals[k][1] for k in range(1, len(models)))
    checks = tuple(check for k in range(1, len(models)) for check in refusals[k][2])
    return Merged(_fused(known, poses, settings, progress), None, why, poses, checks)


def extended(
    known: KnownModel, frames: Sequence[Posed], settings: FusionSettings, coloured: Iterable[KeyFrame] = ()
) -> Model:
    """A known model with what frames show besides, in its own frame.

    Args:
        known: the model.
        frames: tracked against it, with T_model_sensor (4, 4).
        settings: of the fusion.
        coloured: the source of colour beside the model's own.
    """
    own = looks(known, FUSED_VIEWS, _pixels(known.model))
    both = LazyFrames(
        range(len(own) + len(frames)), lambda n: own[n] if n < len(own) else frames[n - len(own)]
    )
    return _model(both, settings, [*_coloured(own), *coloured])


def _place(
    base: KnownModel, other: KnownModel, bounds: MatchSettings
) -> tuple[Array | None, tuple[str, str, Checks]]:
    """T_base_other (4, 4), or None; with it the reason and the checks, in words and as they are."""
    posed = [(View(frame), T) for frame, T in looks(other, SEARCH_VIEWS, SEARCH_PIXELS)]
    posed = [(view, T) for view, T in posed if len(view.points) >= FEWEST_PIXELS]
    if not posed:
        return None, (NO_OVERLAP, 'it shows no surface', ())
    views, poses = [v for v, _ in posed], [T for _, T in posed]
    usual, whole = overlap_loss(other, views, poses)

    def in_common(known: KnownModel, views: Sequence[View], T_model_views: Sequence[Array]) -> float:
        loss, shared = overlap_loss(known, views, T_model_views)
        # a few views may show less of what both have than all do
        least = LEAST_OVERLAP if len(views) == len(posed) else LEAST_OVERLAP / 2
        return loss if shared >= least * whole else np.inf

    # also where the target looks the same a lead is asked: what the scans add to each other would not
    search = Search(in_common, len(views), CANDIDATES, GLANCED, equal_is_same=False)
    match = find_model(base, views, poses, usual, bounds, search)
    return match.T_model_scan, (AMBIGUOUS if match.ambiguous else NO_OVERLAP, match.why, match.checks)


def looks(known: KnownModel, count: int, pixels: int) -> Sequence[Posed]:
    """A model from all sides where enough of it shows: frames with T_model_sensor (4, 4).

    Args:
        known: the model.
        count: of directions, spread evenly.
        pixels: across it.
    """
    points = known.model.points
    centre = points.mean(axis=0, dtype=np.float64) if len(points) else np.zeros(3)
    radius = float(np.linalg.norm(points - centre, axis=1).max(initial=0.0))
    # perspective widens what is near, and around the target the window is free
    focal, size = pixels * AWAY / 2, round(1.15 * pixels) + 2 * MARGIN_PX
    camera = Camera(focal, focal, (size - 1) / 2, (size - 1) / 2, size, size)

    def restore(sight: Array) -> Posed:
        across = np.cross(sight, np.eye(3)[np.argmin(np.abs(sight))])
        across /= np.linalg.norm(across)
        R_model_sensor = np.column_stack([across, np.cross(sight, across), sight])
        T_model_sensor = transform(R_model_sensor, centre - AWAY * radius * sight)
        return known.images.frame(camera, inverse(T_model_sensor)), T_model_sensor

    shown = [
        s for s in sphere_directions(count) if np.count_nonzero(restore(s)[0].depth_fit) >= FEWEST_PIXELS
    ]
    return LazyFrames(shown, restore)


def _fused(
    known: Sequence[KnownModel], poses: Sequence[Array], settings: FusionSettings, progress: Progress
) -> Model:
    """One model of several, at T_first_scan (4, 4)."""
    frames: list[Sequence[Posed]] = []
    for n, one in enumerate(known):
        frames.append(looks(one, FUSED_VIEWS, _pixels(one.model)))
        progress('look', n + 1, len(known))
    posed = LazyFrames(
        [(k, n) for k, own in enumerate(frames) for n in range(len(own))],
        lambda at: _moved(poses[at[0]], frames[at[0]][at[1]]),
    )
    model = _model(posed, settings, _coloured(posed))
    progress('close', 1, 1)
    return model


def _pixels(model: Model) -> int:
    """Pixels across a model at which it was fused."""
    points = model.points
    extent = 2 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    return min(MOST_PIXELS, round(extent / (model.spacing / CLOUD_SPACING)))


def _model(posed: Sequence[Posed], settings: FusionSettings, coloured: Iterable[KeyFrame]) -> Model:
    volume = integrated(posed, settings, measured=False)
    surface = large_parts(volume.surface())
    assert surface is not None  # a model was looked at
    return make_model(surface, coloured, np.zeros(3), close(volume, posed))[0]


def _coloured(posed: Sequence[Posed]) -> Iterator[KeyFrame]:
    """Views of models as sources of colour, without that of gaps."""
    for frame, T in posed:
        if frame.rgb is not None:
            yield KeyFrame(replace(frame, depth=frame.depth_fit), T, 0.0)


def _moved(T: Array, posed: Posed) -> Posed:
    frame, T_model_sensor = posed
    return frame, compose(T, T_model_sensor)
