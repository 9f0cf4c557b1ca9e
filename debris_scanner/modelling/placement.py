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

"""Where a known model lies among the views of a scan, and whether it is the right one.

A search over all attitudes proposes placements; each is fitted to all views at once, whose poses relative to
each other odometry knows. The evidence is the loss of the views against the model as a sensor would see it,
beyond the loss of neighbouring views against each other. It decides whether this is the model, and between
placements. Size is asked for by itself: a flat side that is a little larger further away looks the same.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, apply, compose, exp_se3, inverse, rotation_angle
from debris_scanner.core.results import Check, Checks, at_least, at_most, in_words, passed
from debris_scanner.modelling.rigidity import REACH_PX
from debris_scanner.modelling.symmetry import SHARE, meeting_share, principal_turns
from debris_scanner.registration.likelihood import UNKNOWN_LOSS, mutual_loss, shared_evidence
from debris_scanner.registration.projective import linearise, register, solve_step
from debris_scanner.sensing.rendering import MeshImages
from debris_scanner.sensing.rim import Rim
from debris_scanner.sensing.sensor_model import SensorModel, difference
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.pose_search import global_pose_search, tracking_surface

SEARCHED, PROPOSED = 3, 5  # views from which all attitudes are searched, and the best of each
COARSE_GATES, GATES = (*(27.0,) * 4, *(20.0,) * 4, *(13.0,) * 4), (13.0, 8.0, 8.0, 5.5, 5.5)  # px
THINNED = 5  # coarse steps use one point in so many
SIZE_GATES = (13.0, 8.0, 5.5, 5.5)  # px
SAME = np.radians(4.0)  # placements closer than this are one
FEWEST_PIXELS = 60  # of the model in a view
UNKNOWN_SHARE = 0.01  # of the pixels of a model: with more its outline is not known
WORST = 9.0  # nats a point, of a view that shows nothing of the model
PATCHES = 48  # of the surface, each of which moves along as the model grows
SIZE_TOLERANCE = 0.025  # of the size
JUDGED = 8  # placements, where a glance tells which
ROLLS = 24  # about the axis about which a body of revolution would turn
PART = 0.06  # side of a part of the surface that is compared, over the size
FEWEST_SHOWN, FEWEST_VIEWS = 12, 6  # pixels of a view, and views, that show such a part
EDGE_PX = 2  # pixels so near to what is not compared belong to an edge
OBLIQUE_COS = 0.4  # surface that is more oblique is not compared
AGREED = 0.1  # quantile of what the views say of a part: nine of ten say that it is at least so far off
MOST_OFF = 2.2  # standard deviations of a pixel's depth, of that quantile: right models 0.6 to 1.7
PROMISED_SHARE, LEAST_SHARE = 0.5, 0.25  # of what a lead is if it is right, and of the bound: then it will do
GIVEN_UP = 3.0  # standard errors of the mean of what views say, beyond a bound: then a model is given up


class KnownModel:
    """A model prepared for the search: its sampled surface, and images of it."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.surface = tracking_surface(model)
        shown = model.closed
        self.images = (
            MeshImages(model.vertices, model.triangles, None, model.vertex_rgb)
            if shown is None
            else MeshImages(shown.vertices, shown.triangles, shown.observed, shown.rgb)
        )

    def seen_from(self, view: View, T_model_view: Array) -> View | None:
        """The model as the view's camera would see it; None if it is out of sight."""
        frame = self.images.frame(view.frame.camera, inverse(T_model_view), view.frame.stamp_ns)
        shown, known = np.count_nonzero(frame.depth), np.count_nonzero(frame.depth_fit)
        if known < FEWEST_PIXELS:
            return None
        image = View(frame)
        # what fills a gap may lie within the target: its outline is then no evidence
        if not len(image.points):
            return None
        # what the view shows beside it is the noise of a sensor, which an image has none of
        image.noise, image.depth_step = view.noise, view.depth_step
        image.unoccluded = bool(shown - known <= UNKNOWN_SHARE * shown)
        return image


@dataclass(frozen=True)
class MatchSettings:
    """Bounds, nats a point: a model explains the views hardly worse than neighbours do, and others worse.

    The lead is not in nats of all points: what is wrong with a model is wrong in each view.
    """

    max_excess: float  # of the best placement's loss over that of neighbours
    min_lead: float  # of the best placement over the next one that looks different


@dataclass(frozen=True)
class Placement:
    """A fit of the model to all views: T_model_scan (4, 4), and its mean loss, nats a point."""

    T_model_scan: Array
    loss: float


@dataclass(frozen=True)
class Match:
    """What was found: ``T_model_scan`` (4, 4), None if this is another target or its attitude is in doubt."""

    T_model_scan: Array | None
    why: str  # the checks in words
    checks: Checks = ()
    ambiguous: bool = False  # it is this one, in one of several attitudes
    disagreed: float = 0.0  # standard deviation of the views' losses against it, nats a point


# of views against a model at T_model_view (4, 4), nats a point; inf where they say nothing
Loss = Callable[[KnownModel, Sequence[View], Sequence[Array]], float]


@dataclass(frozen=True)
class Search:
    """How a model is looked for: what a placement costs, and which are one."""

    loss: Loss
    views: int = SEARCHED  # from which all attitudes are searched
    proposed: int = PROPOSED  # attitudes, from each
    glanced: int | None = None  # views that tell which placements all views judge; None: each is judged
    equal_is_same: bool = True  # no lead is asked over placements at which the model looks the same


def find_model(
    known: KnownModel,
    views: Sequence[View],
    poses: Sequence[Array],
    usual: float,
    settings: MatchSettings,
    search: Search | None = None,
) -> Match:
    """Place a model among views.

    Args:
        known: the model.
        views: some of a scan.
        poses: T_scan_view (4, 4).
        usual: loss of neighbouring views against each other, nats a point (:func:`usual_loss`).
        settings: the bounds.
        search: None: of a whole model, by :func:`whole_loss`.
    """
    search = search or Search(whole_loss)
    found = placements(known, views, poses, search)
    if not found:
        return Match(None, 'no placement shows enough of the model')
    best, bound = found[0], settings.max_excess
    excess = best.loss - usual
    checks: Checks = (at_most('excess_loss', excess, bound),)
    if not passed(checks):
        return Match(None, in_words(checks), checks)
    placed = [compose(best.T_model_scan, T) for T in poses]
    size = size_ratio(known, views, placed).ratio
    checks += (at_most('size_error', abs(size - 1), SIZE_TOLERANCE),)
    if not passed(checks):
        return Match(None, in_words(checks, f'the target has {size:.3f} of the size of the model'), checks)
    other = _next(known, found, search.equal_is_same)
    lead, wanted = np.inf if other is None else other.loss - best.loss, settings.min_lead
    if other is not None and lead < wanted and search.equal_is_same:
        promised = promised_lead(known, views, poses, best, other)
        wanted = min(wanted, max(PROMISED_SHARE * promised, LEAST_SHARE * wanted))
    checks += (at_least('lead', lead, wanted),)
    if not passed(checks):
        return Match(None, in_words(checks), checks, ambiguous=True)
    disagreed = float(np.std(view_losses(known, views, placed), ddof=min(1, len(views) - 1)))
    return Match(best.T_model_scan, in_words(checks), checks, disagreed=disagreed)


@dataclass(frozen=True)
class Disagreement:
    """Where a target's surface lies most beside that of a model."""

    at: Array  # (3,), model frame
    by: float  # m, along the ray, as nine of ten views say; positive where the target stands out
    deviations: float  # the same in standard deviations of a pixel's depth
    share: float  # of the parts that were compared and lie further off than allowed

    def told(self) -> dict[str, Any]:
        """For summary.json."""
        return {
            'at_m': self.at.tolist(),
            'by_m': self.by,
            'deviations': self.deviations,
            'allowed_deviations': MOST_OFF,
            'share': self.share,
        }

    @property
    def check(self) -> Check:
        """Whether it may be the model's target."""
        return at_most('surface_deviations', self.deviations, MOST_OFF)

    @property
    def words(self) -> str:
        """Where it lies, for people."""
        x, y, z = self.at * 1e3
        side = 'before' if self.by > 0 else 'behind'
        return (
            f'the surface lies {abs(self.by) * 1e3:.1f} mm {side} that of the model at '
            f'({x:.0f}, {y:.0f}, {z:.0f}) mm, and as far off on {100 * self.share:.1f} % of what was seen'
        )


def disagreement(shown: Sequence[tuple[View, Array, View]], sigma: float) -> Disagreement | None:
    """How far a target's surface lies beside that of a model; None where too little of it was seen.

    What an edge or a reflection does differs from view to view; where nine of ten views agree that a part of
    the surface is off, the model is another's.

    Args:
        shown: views of the target, T_model_view (4, 4) as registered, and the model as each should show it.
        sigma: m, of a pixel's depth.
    """
    points, before, by = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, np.intp)]
    for n, (view, T, image) in enumerate(shown):
        behind, cosine, seen = difference(view, np.eye(4), image, REACH_PX)
        inner = scipy.ndimage.binary_erosion(seen, iterations=EDGE_PX) & (cosine > OBLIQUE_COS)
        points.append(apply(T, view.frame.camera.back_project(view.frame.depth)[inner]))
        before.append(-behind[inner])
        by.append(np.full(np.count_nonzero(inner), n))
    where, out, seen_by = np.concatenate(points), np.concatenate(before), np.concatenate(by)
    if not len(where):
        return None
    side = PART * float(np.ptp(where, axis=0).max())
    off, at = [], []
    for aside in (0.0, 0.5):  # a change may lie on the border of two parts
        _, part = np.unique(np.floor(where / side + aside), axis=0, return_inverse=True)
        order = np.argsort(part.ravel(), kind='stable')
        for inside in np.split(order, np.flatnonzero(np.diff(part.ravel()[order])) + 1):
            views, count = np.unique(seen_by[inside], return_counts=True)
            many = views[count >= FEWEST_SHOWN]
            if len(many) < FEWEST_VIEWS:
                continue
            said = np.array([np.median(out[inside][seen_by[inside] == n]) for n in many])
            sign = 1.0 if np.median(said) > 0 else -1.0
            off.append(sign * max(0.0, float(np.quantile(sign * said, AGREED))))
            at.append(where[inside].mean(axis=0))
    if not off:
        return None
    worst = int(np.argmax(np.abs(off)))
    share = float(np.mean(np.abs(off) > MOST_OFF * sigma))
    return Disagreement(at[worst], off[worst], abs(off[worst]) / sigma, share)


class Answer(NamedTuple):
    """What frames say of the model that they were tracked by."""

    why: str  # the checks in words
    refused: str  # why it is wrong; empty if it is right
    checks: Checks = ()
    disagreed: float = 0.0  # see :class:`Match`: by how much views did when the model was found
    beside: Disagreement | None = None  # where the surfaces differ most; None if that was not asked

    def too_few(self, what: str, count: int, least: int) -> 'Answer':
        """The answer where there is too little to tell."""
        checks = (at_least(what, count, least),)
        return self._replace(refused=in_words(checks), checks=checks)


def asked_again(
    known: KnownModel,
    pairs: Sequence[Sequence[tuple[View, Array]]],
    max_excess: float,
    disagreed: float,
    sensor: Callable[[Sequence[View]], SensorModel] | None = None,
) -> Answer:
    """What frames say of the model that they were tracked by.

    It was believed once, for what some views said of it; so it is given up only where what these say lies
    beyond the bound by more than such views say by chance (:data:`GIVEN_UP`). Nor is it enough that a search
    misses the attitude that is tracked, on a body that is nearly round: another one must be better.

    Args:
        known: the model.
        pairs: frames, each with the next one, and T_model_view (4, 4).
        max_excess: bound on the loss over that of neighbours, nats a point.
        disagreed: standard deviation of the views' losses when the model was found, nats a point.
        sensor: that took some views. Given with frames that were registered to the model: their surfaces are
            compared with the model's, too.
    """
    views, poses = [pair[0][0] for pair in pairs], [pair[0][1] for pair in pairs]
    chance = GIVEN_UP * disagreed / np.sqrt(len(views))
    loss = whole_loss(known, views, poses)
    excess = loss - _loss_of_neighbours(pairs)
    size = size_ratio(known, views, poses)
    others = placements(known, views, poses, Search(whole_loss))
    other = _next(known, [Placement(np.eye(4), loss), *others], equal_is_same=True)
    lead = np.inf if other is None else other.loss - loss
    asked = (
        (at_most('excess_loss', excess, max_excess + chance), 'it explains the frames badly'),
        (
            at_most('size_error', abs(size.ratio - 1), SIZE_TOLERANCE + GIVEN_UP * size.sigma),
            f'the target has {size.ratio:.3f} of the size of the model',
        ),
        (at_least('lead', lead, -chance), 'it fits better where it would look turned'),
    )
    checks = tuple(check for check, _ in asked)
    note = next((note for check, note in asked if not check.passed), '')
    if note or sensor is None:
        return Answer(in_words(checks), note and in_words(checks, note), checks, disagreed)
    shown = [(v, T, image) for pair in pairs for v, T in pair if (image := known.seen_from(v, T)) is not None]
    beside = disagreement(shown, sensor(views).sigma_m)
    if beside is None:
        return Answer(in_words(checks), '', checks, disagreed)
    checks += (beside.check,)
    refused = '' if beside.check.passed else in_words(checks, beside.words)
    return Answer(in_words(checks), refused, checks, disagreed, beside)


def _loss_of_neighbours(pairs: Sequence[Sequence[tuple[View, Array]]]) -> float:
    """The usual loss of frames registered to the one before, nats a point.

    Poses that a model gave could not contradict it.
    """
    usual = []
    for (view, T), (after, T_after) in pairs:
        registered = register(after, T_after, view, T)
        if registered is not None:
            usual.append(usual_loss([view, after], [T, registered[0]]))
    return float(np.median(usual)) if usual else UNKNOWN_LOSS


def placements(
    known: KnownModel, views: Sequence[View], poses: Sequence[Array], search: Search
) -> list[Placement]:
    """Distinct fits of the model to all views, best first."""
    chosen = np.unique(np.linspace(0, len(views) - 1, search.views).round().astype(int))
    starts = [
        compose(inverse(T), inverse(poses[k]))
        for k in chosen.tolist()
        for T in global_pose_search(known.surface, views[k], search.proposed)
    ]
    some = np.linspace(0, len(views) - 1, search.glanced or len(views)).astype(int).tolist()
    found: list[Placement] = []

    def judged(T: Array, by: Sequence[int]) -> Placement:
        """The placement of a fit (4, 4), with its loss in some of the views."""
        loss = search.loss(known, [views[k] for k in by], [compose(T, poses[k]) for k in by])
        return Placement(T, loss)

    def add(start: Array) -> None:
        """Fit a start (4, 4) to all views, and add it if it is new."""
        T = fitted(known.surface, views, poses, start)
        if all(rotation_angle(T[:3, :3] @ p.T_model_scan[:3, :3].T) > SAME for p in found):
            found.append(judged(T, some))

    for start in starts:
        add(start)
    if found:
        best = min(found, key=lambda p: p.loss)
        for turn in principal_turns(known.surface.points, ROLLS):
            add(compose(turn, best.T_model_scan))
    if search.glanced is not None:
        likely = sorted(found, key=lambda p: p.loss)[:JUDGED]
        found = [judged(p.T_model_scan, range(len(views))) for p in likely]
    return sorted((p for p in found if np.isfinite(p.loss)), key=lambda p: p.loss)


def usual_loss(views: Sequence[View], poses: Sequence[Array]) -> float:
    """Median loss of neighbouring views against each other, nats a point."""
    posed = list(zip(views, poses, strict=True))
    return float(np.median([_loss(*a, *b) for a, b in pairwise(posed)])) if len(posed) > 1 else UNKNOWN_LOSS


def whole_loss(known: KnownModel, views: Sequence[View], T_model_views: Sequence[Array]) -> float:
    """Mean loss of views against a model, both ways, nats a point; see :data:`Loss`."""
    return float(np.mean(view_losses(known, views, T_model_views)))


def view_losses(known: KnownModel, views: Sequence[View], T_model_views: Sequence[Array]) -> list[float]:
    """Loss of each view against a model, both ways, nats a point."""
    losses = []
    for view, T in zip(views, T_model_views, strict=True):
        image = known.seen_from(view, T)
        losses.append(WORST if image is None else _loss(view, T, image, T))
    return losses


def overlap_loss(
    known: KnownModel, views: Sequence[View], T_model_views: Sequence[Array]
) -> tuple[float, float]:
    """Loss of views against a model, nats a point that both show, and how many points of a view that is.

    Unlike :func:`whole_loss` it says nothing of what only one of them shows.
    """
    nats = points = 0.0
    for view, T in zip(views, T_model_views, strict=True):
        image = known.seen_from(view, T)
        if image is None:
            continue
        shared = shared_evidence(view, T, image, T)
        nats, points = nats + shared[0], points + shared[1]
    return nats / max(points, 1.0), points / len(views)


class Size(NamedTuple):
    """Size of the target over that of a model, and its standard deviation as the views disagree."""

    ratio: float
    sigma: float


def size_ratio(known: KnownModel, views: Sequence[View], T_model_views: Sequence[Array]) -> Size:
    """Size of the target as the views show it, over that of the model.

    The fit has a seventh unknown, the size. A patch of the surface is shifted by it in proportion to its
    distance from the origin; patches are small, so that each is moved as a whole. Where the fit ends, each
    view pulls its own way: the spread of that is what they disagree by.
    """
    poses, size, sigma = list(T_model_views), 1.0, 0.0
    patches = list(_patches(known.surface))
    # what a size four tolerances off moves: gates for more would meet other parts of a small target
    reach = 2 * SIZE_TOLERANCE * float(np.ptp(known.surface.points, axis=0).max())
    for gate in SIZE_GATES:
        H, pulls = np.zeros((7, 7)), np.zeros((len(views), 7))
        for n, (view, T) in enumerate(zip(views, poses, strict=True)):
            for patch, middle in patches:
                grown = _scaled(patch, size)
                lin = linearise(grown, np.eye(4), view, T, min(gate, reach / view.resolution))
                moves = np.zeros((6, 7))  # of the patch: against the view's twist, and outwards
                moves[:, :6] = -np.eye(6)
                moves[3:, 6] = middle
                H += moves.T @ lin.H @ moves / view.resolution**2
                pulls[n] += moves.T @ lin.g / view.resolution**2
        damping = np.diag(np.where(np.diag(H) > 0, 1e-6 * np.diag(H), 1.0))
        steps = -np.linalg.solve(H + damping, pulls.T)  # (7, views): as each would have it
        step = steps.sum(axis=1)
        poses = [compose(exp_se3(step[:6]), T) for T in poses]
        size += float(step[6])
        sigma = float(np.std(steps[6]) * len(views) / np.sqrt(max(1, len(views) - 1)))
    return Size(size, sigma)


def fitted(surface: Surface, views: Sequence[View], poses: Sequence[Array], start: Array) -> Array:
    """T_model_scan (4, 4) after a joint fit to all views."""
    T_model_scan, thin = start, surface.thinned(THINNED)
    for n, gate in enumerate((*COARSE_GATES, *GATES)):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for view, T in zip(views, poses, strict=True):
            source = thin if n < len(COARSE_GATES) else surface
            lin = linearise(source, np.eye(4), view, compose(T_model_scan, T), gate)
            H += lin.H / view.resolution**2
            g -= lin.g / view.resolution**2  # a twist of the views is one of the model the other way
        T_model_scan = compose(exp_se3(solve_step(H, g)), T_model_scan)
    return T_model_scan


def _loss(a: View, T_a: Array, b: View, T_b: Array) -> float:
    """The larger loss of two views against each other, nats a point."""
    return min(WORST, mutual_loss(a, T_a, b, T_b))


def _next(known: KnownModel, found: Sequence[Placement], equal_is_same: bool) -> Placement | None:
    """The placement after the first one; with ``equal_is_same`` the model must look different at it."""
    best = found[0]
    for other in found[1:]:
        turn = compose(best.T_model_scan, inverse(other.T_model_scan))
        if not (equal_is_same and looks_equal(known, turn)):
            return other
    return None


def promised_lead(
    known: KnownModel, views: Sequence[View], poses: Sequence[Array], best: Placement, other: Placement
) -> float:
    """The lead that a placement has over another if it is right, nats a point; inf if neither is in sight.

    It is the loss of the model's images at the one given those at the other. For a wrong placement to lead by
    half of that, the model would have to be wrong by half of what tells the two apart.
    """
    same, promised = np.eye(4), []
    for view, T in zip(views, poses, strict=True):
        here, there = (known.seen_from(view, compose(p.T_model_scan, T)) for p in (best, other))
        if here is not None and there is not None:
            promised.append(_loss(here, same, there, same) - _loss(here, same, here, same))
    return float(np.mean(promised)) if promised else np.inf


def looks_equal(known: KnownModel, turn: Array) -> bool:
    """Whether a motion (4, 4) maps the model onto itself."""
    model = known.model
    return meeting_share(model.points, model.normals, model.spacing, turn) >= SHARE


def _patches(surface: Surface) -> Iterator[tuple[Surface, Array]]:
    """Small parts of a surface, each with its mean (3,)."""
    _, label = scipy.cluster.vq.kmeans2(surface.points.astype(np.float64), PATCHES, seed=0, minit='points')
    for k in range(PATCHES):
        points, normals = surface.points[label == k], surface.normals[label == k]
        if len(points):
            rim = Rim(points, normals, np.zeros(len(points), np.uint8))
            yield Surface(points, normals, points, rim), points.mean(axis=0).astype(np.float64)


def _scaled(patch: Surface, size: float) -> Surface:
    points = (patch.points * np.float32(size)).astype(np.float32)
    return Surface(points, patch.normals, points, Rim(points, patch.normals, patch.rim.edge))
