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

"""The attitude of a known model that its colours show, where its shape looks the same in several.

A rocket body looks the same however it is rolled, a box in two or four ways: their paint tells these
attitudes apart. The views' pictures are compared with the model as each of them should show it, by the same
likelihood as two views are (:mod:`debris_scanner.registration.picture_terms`). About an axis of revolution
the shape says nothing but noise, which is taken out.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from debris_scanner.core.geometry import (
    Array,
    compose,
    exp_se3,
    log_so3,
    rotation_angle,
    sphere_directions,
    transform,
)
from debris_scanner.core.results import Checks, at_least
from debris_scanner.modelling.placement import LEAST_SHARE, PROMISED_SHARE, ROLLS, SAME, KnownModel
from debris_scanner.modelling.refinement import refine_to_model
from debris_scanner.modelling.symmetry import Symmetry, symmetry_of
from debris_scanner.registration.picture_terms import picture_terms
from debris_scanner.registration.projective import linearise
from debris_scanner.sensing.views import View

GLANCED = 3  # views that show each attitude first
FITTED = 4  # of the attitudes, those that are looked at in all views
COARSE, FINE = 3, 3  # steps of a roll, by the coarse pictures and the others
MOST_ROLL = np.radians(180 / ROLLS)  # of a step
SIDES, TURNED = 6, 4  # of the model, and turns, for what its paint shows at most
IN_SIGHT = 0.5  # of the views' points, on surface that the model has: with less they say nothing of its paint
MET = 5.5  # px: points so near to the model's surface are compared

Posed = Sequence[tuple[View, Array]]  # views with T_model_view or T_scan_view (4, 4)


class Painted(NamedTuple):
    """The model as its colours show it: T_model_scan (4, 4); None where several attitudes are as likely."""

    T_model_scan: Array | None
    checks: Checks = ()


class Paint:
    """What a known model's colours say of poses; nothing, if it has none."""

    def __init__(self, known: KnownModel) -> None:
        self._known = known

    @cached_property
    def _symmetry(self) -> Symmetry:
        """How the shape of a coloured model is turned onto itself."""
        model = self._known.model
        if not self._known.images.coloured:
            return Symmetry([], None)
        return symmetry_of(model.points, model.normals, model.spacing, ROLLS)

    def placed(
        self, views: Sequence[View], poses: Sequence[Array], T_model_scan: Array, min_lead: float
    ) -> Painted:
        """The placement at which the model's paint is that of the views, among those that look the same.

        Args:
            views: some of a scan.
            poses: T_scan_view (4, 4).
            T_model_scan: (4, 4), a placement by the shape.
            min_lead: of it over the next one, nats a point; less where less is promised.
        """
        posed = [(v, T) for v, T in zip(views, poses, strict=True) if v.picture is not None]
        if not (self._known.images.coloured and posed and self._symmetry.turns):
            return Painted(T_model_scan)
        starts = [compose(turn, T_model_scan) for turn in (np.eye(4), *self._symmetry.turns)]
        glanced = [self._says(posed[:: -(-len(posed) // GLANCED)], T) for T in starts]
        likely = np.argsort(glanced)[::-1].tolist()[:FITTED]
        rolled = [self._rolled(posed, starts[n]) for n in likely]
        fits = sorted(((self._says(posed, T), T) for T in rolled), key=lambda fit: -fit[0])
        (said, best), least = fits[0], LEAST_SHARE * min_lead
        other = next((fit for fit in fits if _apart(fit[1], best) > SAME), None)
        if other is None:
            return Painted(T_model_scan if said < least else best)
        lead = said - other[0]
        if said < least:
            # they show no paint: there is none, or another than the model has, or it is out of sight
            seen = self._in_sight(posed, best) >= IN_SIGHT or self._differs(posed[0][0]) < least
            return Painted(T_model_scan) if seen else Painted(None, (at_least('picture_lead', lead, least),))
        promised = self._promised(posed, best, other[1])
        if promised < least:  # the paint looks the same, too
            return Painted(best)
        check = at_least('picture_lead', lead, min(min_lead, PROMISED_SHARE * promised))
        return Painted(best if check.passed else None, (check,))

    def refined(self, view: View, T_model_view: Array) -> tuple[Array, Array]:
        """Pose (4, 4) of a view registered to the model, and its information (6, 6).

        Rolled by its picture about an axis of revolution; without a picture not rolled.
        """
        T, H = refine_to_model(view, T_model_view, self._known.surface)
        if self._symmetry.axis is None:
            return T, H
        roll = log_so3(T[:3, :3] @ T_model_view[:3, :3].T) @ self._symmetry.axis[:3]
        T = compose(exp_se3(-roll * self._symmetry.axis), T)
        return (T if view.picture is None else compose(self._rolled([(view, T)], np.eye(4)), T)), H

    def _rolled(self, posed: Posed, T_model_scan: Array) -> Array:
        """A placement (4, 4) rolled about the axis of revolution, if there is one, by the pictures."""
        axis = self._symmetry.axis
        if axis is None:
            return T_model_scan
        for coarse in (True,) * COARSE + (False,) * FINE:
            information = gradient = 0.0
            for view, pose in posed:
                shown = self._terms(view, compose(T_model_scan, pose), coarse)
                if shown is not None:
                    information += float(axis @ shown[0] @ axis)
                    gradient += float(axis @ shown[1])
            if information > 0:
                step = np.clip(-gradient / information, -MOST_ROLL, MOST_ROLL)
                T_model_scan = compose(exp_se3(step * axis), T_model_scan)
        return T_model_scan

    def _terms(
        self, view: View, T_model_view: Array, coarse: bool = False
    ) -> tuple[Array, Array, float] | None:
        """Information (6, 6), gradient (6,) and nats of a view's picture; None without a common one."""
        image = self._known.seen_from(view, T_model_view)
        if image is None:
            return None
        return picture_terms(view, T_model_view, image, T_model_view, MET * view.resolution, coarse=coarse)

    def _says(self, posed: Posed, T_model_scan: Array) -> float:
        """What the views' pictures say for a placement, nats a point."""
        shown = [self._terms(view, compose(T_model_scan, pose)) for view, pose in posed]
        points = sum(len(view.points) for view, _ in posed)
        return sum(terms[2] for terms in shown if terms is not None) / max(points, 1)

    def _in_sight(self, posed: Posed, T_model_scan: Array) -> float:
        """Share of the views' points that show surface which the model has, at a placement."""
        matched = points = 0.0
        for view, pose in posed:
            T = compose(T_model_scan, pose)
            image = self._known.seen_from(view, T)
            points += len(view.points)
            matched += 0.0 if image is None else linearise(view, T, image, T, MET).stats.matched
        return matched / max(points, 1.0)

    def _differs(self, like: View) -> float:
        """By how much turns that leave the shape change the picture, nats a point, at most, of any side.

        Args:
            like: a view, whose camera and distance are taken.
        """
        centre = self._known.model.points.mean(axis=0).astype(np.float64)
        behind = transform(np.eye(3), np.array([0.0, 0.0, -float(like.centroid[2])]))
        turned = self._symmetry.turns[:: -(-len(self._symmetry.turns) // TURNED)]
        most = 0.0
        for side in sphere_directions(SIDES):
            R, _ = scipy.spatial.transform.Rotation.align_vectors(side[None], np.array([[0.0, 0.0, 1.0]]))
            pose = compose(transform(R.as_matrix(), centre), behind)
            most = max([most, *(self._promised([(like, pose)], np.eye(4), turn) for turn in turned)])
        return most

    def _promised(self, posed: Posed, best: Array, other: Array) -> float:
        """The lead, nats a point, that a placement has over another by the model's own images."""
        nats = points = 0.0
        for view, pose in posed:
            here, there = (self._known.seen_from(view, compose(T, pose)) for T in (best, other))
            if here is None or there is None:
                continue
            same, gate = np.eye(4), MET * view.resolution
            own, others = (picture_terms(here, same, image, same, gate) for image in (here, there))
            nats += (0.0 if own is None else own[2]) - (0.0 if others is None else others[2])
            points += len(here.points)
        return nats / max(points, 1.0)


def _apart(a: Array, b: Array) -> float:
    return rotation_angle(a[:3, :3] @ b[:3, :3].T)
