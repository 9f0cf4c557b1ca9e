"""What the sensor leaves possible: the same fusion with the true poses, judged like a scan."""

from collections.abc import Sequence

import numpy as np

from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array, compose, inverse, transform
from debris_scanner.refinement import fuse, make_model
from debris_scanner.results import NO_TARGET, ScanResult, StampedPose
from debris_scanner.settings import Settings


def true_pose_result(frames: Sequence[tuple[TargetFrame, Array]], settings: Settings) -> ScanResult:
    """The result of a scan that knew every pose.

    Args:
        frames: isolated targets with their true T_sensor_target (4, 4), as many as a scan fuses.
        settings: whose fusion is taken.
    """
    if not frames:
        return ScanResult(NO_TARGET, None)
    # A scan's target frame has the first frame's attitude. A simulated target's own has its faces along the
    # axes of the voxels, where thin plates fare otherwise than in any scan.
    R_first = frames[0][1][:3, :3]
    T_target_new = transform(R_first.T, np.zeros(3))
    poses = [(frame, compose(T, T_target_new)) for frame, T in frames]
    surface = fuse([(frame, inverse(T)) for frame, T in poses], settings.fusion)
    if surface is None:
        return ScanResult(NO_TARGET, None)
    model, shift = make_model(surface, [], None)
    T_new_model = transform(np.eye(3), shift)
    stamped = [StampedPose(frame.stamp_ns, compose(T, T_new_model)) for frame, T in poses]
    return ScanResult(None, model, poses=stamped, odometry=stamped)
