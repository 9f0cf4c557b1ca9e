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

"""The model's verdict: is the graph consistent, do the frames fit the model, is the rotation observable?"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.parameters import parameter
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
)
from debris_scanner.modelling.evidence import FrameEvidence, RotationCostProfile, SegmentEvidence
from debris_scanner.registration.projective import RegistrationStats


@dataclass(frozen=True)
class VerdictSettings:
    """Bounds of a model that is published."""

    min_frames: int = parameter(10, 'fewer frames with a target are no scan', '', 1, 10**6)
    min_observability: float = parameter(
        0.0017, 'least rotation information a point, relative to the size squared (median)', '', 0.0, 1.0
    )
    min_rotation_cost_ratio: float = parameter(
        1.4,
        'least factor by which turning the model by 10 to 30 degrees about its weakest axis worsens its fit',
        '',
        1.0,
        100.0,
    )
    max_rms: float = parameter(1.7, 'largest residual of an edge (90th percentile)', 'px', 0.01, 100.0)
    max_conflict_ratio: float = parameter(
        0.04, "largest share of an edge's points in seen free space (90th percentile)", '', 0.0, 1.0
    )
    min_visible_inlier_ratio: float = parameter(
        0.75, 'least share of the model in view that a frame agrees with (10th percentile)', '', 0.0, 1.0
    )
    max_model_conflict_ratio: float = parameter(
        0.12, 'largest share of the model in space that a frame saw free (90th percentile)', '', 0.0, 1.0
    )
    max_model_free_space_violation: float = parameter(
        0.06,
        'and by how much what lies in front of the measured may exceed the median (95th percentile)',
        '',
        0.0,
        1.0,
    )
    max_pose_correction_deg: float = parameter(
        1.3, 'turn of a frame that is registered to the model alone (90th percentile)', 'deg', 0.01, 180.0
    )
    max_pose_correction: float = parameter(1.35, 'and shift of the model in it', 'px', 0.01, 1000.0)
    max_outlier_deg: float = parameter(
        3.0, 'turn of any frame that shows half as much as frames usually do', 'deg', 0.01, 180.0
    )
    min_cost_ratio: float = parameter(
        1.1,
        'factor by which one pose must fit worse than another to be told from it: a frame as posed from where'
        ' it comes to rest, a stretch between gaps turned by 10 to 180 degrees from one as posed',
        '',
        1.0,
        100.0,
    )
    max_model_silhouette_violation: float = parameter(
        0.08, "largest share of the model beside a frame's silhouette (90th percentile)", '', 0.0, 1.0
    )
    max_rejected_closures: float = parameter(
        0.1, 'largest share of closure edges that were switched off', '', 0.0, 1.0
    )


# What neighbouring key frames show is the sensor's doing. A scan may be so much worse than they are.
WORSE_RMS = 1.25
WORSE_CONFLICT = 2.0
WORSE_INLIERS = 0.9


@dataclass(frozen=True)
class Baseline:
    """What neighbouring key frames show of each other, which no error of the loop touches."""

    rms: float = 0.0  # px, 90th percentile
    conflict_ratio: float = 0.0  # 90th percentile
    visible_inlier_ratio: float = 1.0  # 10th percentile

    @staticmethod
    def of(neighbours: Sequence[RegistrationStats]) -> 'Baseline':
        """Of registered neighbours; without any, those of a perfect sensor."""
        if not neighbours:
            return Baseline()
        return Baseline(
            float(np.percentile([a.rms for a in neighbours], 90)),
            float(np.percentile([a.conflict_ratio for a in neighbours], 90)),
            float(np.percentile([a.visible_inlier_ratio for a in neighbours], 10)),
        )


def judge_graph(
    edge_stats: Sequence[RegistrationStats],
    closure_weights: Sequence[float],
    observability: Sequence[float],
    settings: VerdictSettings,
    baseline: Baseline | None = None,
) -> tuple[str, str] | None:
    """None if a relaxed graph is consistent, else the reason and the numbers in words."""
    baseline = baseline or Baseline()
    max_rms = max(settings.max_rms, WORSE_RMS * baseline.rms)
    max_conflict = max(settings.max_conflict_ratio, WORSE_CONFLICT * baseline.conflict_ratio)
    seen = float(np.median(observability)) if len(observability) else 0.0
    if seen < settings.min_observability:
        return UNOBSERVABLE_ROTATION, f'rotation information {seen:.2g} < {settings.min_observability:.2g}'
    rms = float(np.percentile([a.rms for a in edge_stats], 90))
    free = float(np.percentile([a.conflict_ratio for a in edge_stats], 90))
    rejected_closures = float(np.mean([w < 0.5 for w in closure_weights])) if len(closure_weights) else 0.0
    if rms > max_rms:
        return INCONSISTENT_MODEL, f'residual {rms:.2f} px > {max_rms:.2f} px'
    if free > max_conflict:
        return INCONSISTENT_MODEL, f'free space {free:.3f} > {max_conflict:.3f}'
    if rejected_closures > settings.max_rejected_closures:
        return INCONSISTENT_MODEL, f'{rejected_closures:.0%} of the closures contradict the rest'
    return None


def judge_model(
    evidence: Sequence[FrameEvidence],
    settings: VerdictSettings,
    baseline: Baseline | None = None,
    edge_stats: Sequence[RegistrationStats] = (),
) -> str | None:
    """None if a model explains the frames it was made from, else the numbers in words.

    A doubled surface lies in free space of some frames, or beside their silhouettes. Frames at a wrong pose
    have a large pose correction, since most others made the model. A model that is coarser than its frames
    explains less of them; that is no fault where the frames explain each other as neighbours do.

    Args:
        evidence: of frames against the model.
        settings: the bounds.
        baseline: what neighbouring key frames show of each other.
        edge_stats: of the graph's edges, at the poses judged.
    """
    against_model = [e.stats for e in evidence]
    explained = float(np.percentile([a.visible_inlier_ratio for a in against_model], 10))
    free = float(np.percentile([a.conflict_ratio for a in against_model], 90))
    in_front = [a.free_space_violation_ratio for a in against_model]
    contradicted = float(np.percentile(in_front, 95) - np.median(in_front))
    outside = float(np.percentile([a.silhouette_violation_ratio for a in against_model], 90))
    turn = float(np.degrees(np.percentile([e.turn for e in evidence], 90)))
    shift = float(np.percentile([e.shift for e in evidence], 90))
    s, baseline = settings, baseline or Baseline()
    mutual = Baseline.of(edge_stats).visible_inlier_ratio if edge_stats else 0.0
    frames_agree = mutual >= WORSE_INLIERS * baseline.visible_inlier_ratio
    max_conflict = max(s.max_model_conflict_ratio, WORSE_CONFLICT * baseline.conflict_ratio)
    if explained < s.min_visible_inlier_ratio and not frames_agree:
        return f'the model explains {explained:.2f} < {s.min_visible_inlier_ratio:.2f} of what frames see'
    if free > max_conflict:
        return f'{free:.3f} > {max_conflict:.3f} of the model lies in seen free space'
    if contradicted > s.max_model_free_space_violation:
        return f'frames contradict the others: they see {contradicted:.3f} more of the model in free space'
    if outside > s.max_model_silhouette_violation:
        return (
            f'{outside:.3f} > {s.max_model_silhouette_violation:.3f} of the model lies beside the silhouettes'
        )
    bound = s.max_pose_correction_deg
    if turn > bound:
        return f'frames are out of place: the model turns them by {turn:.2f} > {bound:.2f} deg'
    if shift > s.max_pose_correction:
        shifts = f'{shift:.2f} > {s.max_pose_correction:.2f} px'
        return f'frames are out of place: the model shifts them by {shifts}'
    return None


def judge_frames(
    evidence: Sequence[FrameEvidence], segments: Iterable[SegmentEvidence], settings: VerdictSettings
) -> str | None:
    """None if no frame is out of place, else the numbers in words.

    A frame with a large pose correction is accepted if the correction hardly improves its fit, and if every
    segment of the scan is confirmed by a model of the others.

    Args:
        evidence: of a model that passed `judge_model`.
        segments: evaluated only where a frame has a large correction.
        settings: the bounds.
    """
    half = 0.5 * np.median([e.stats.visible for e in evidence])
    bound = np.radians(settings.max_outlier_deg)
    out = [e for e in evidence if e.stats.visible >= half and e.turn > bound]
    slid = all(e.gain < settings.min_cost_ratio for e in out)
    if not out or (slid and all(_is_confirmed(s, settings) for s in segments)):
        return None
    turn = np.degrees(max(e.turn for e in out))
    return f'a frame is out of place: the model turns it by {turn:.2f} > {settings.max_outlier_deg:.2f} deg'


def _is_confirmed(segment: SegmentEvidence, settings: VerdictSettings) -> bool:
    slides = np.degrees(segment.turn) > settings.max_pose_correction_deg
    return not slides and segment.least_cost >= settings.min_cost_ratio


def judge_rotation(scan: RotationCostProfile, settings: VerdictSettings) -> str | None:
    """None if the frames exclude rotated poses of the model, else the numbers in words."""
    if scan.least >= settings.min_rotation_cost_ratio:
        return None
    axis = ', '.join(f'{a:.2f}' for a in scan.axis)
    worse = f'{scan.least:.2f} < {settings.min_rotation_cost_ratio:.2f}'
    return f'turned about ({axis}) the model fits the frames only {worse} times worse'


def judge_scan(frames: int, observability: Sequence[float], settings: VerdictSettings) -> tuple[str, str]:
    """Why a scan without a closed loop has no model."""
    if frames == 0:
        return NO_TARGET, 'no frame showed a target in the box'
    if frames < settings.min_frames:
        return TOO_FEW_FRAMES, f'{frames} frames showed a target, {settings.min_frames} are needed'
    seen = float(np.median(observability)) if len(observability) else np.inf
    if seen < settings.min_observability:
        return (
            UNOBSERVABLE_ROTATION,
            f'the target looks the same while it turns (rotation information {seen:.2g})',
        )
    return NO_CLOSURE, 'no face was seen a second time'
