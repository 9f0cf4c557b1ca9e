"""What the sensor leaves possible: the same fusion with the true poses, judged like a scan."""

from collections.abc import Sequence

from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array, inverse
from debris_scanner.refinement import fuse, make_model
from debris_scanner.results import NO_TARGET, ScanResult, StampedPose
from debris_scanner.settings import Settings


def true_pose_result(frames: Sequence[tuple[TargetFrame, Array]], settings: Settings) -> ScanResult:
    """The result of a scan that knew every pose.

    Args:
        frames: isolated targets with their true T_sensor_target (4, 4), as many as a scan fuses.
        settings: whose fusion is taken.
    """
    surface = fuse([(f, inverse(T)) for f, T in frames], settings.fusion) if frames else None
    if surface is None:
        return ScanResult(NO_TARGET, None)
    model, shift = make_model(surface, [], None)
    poses = []
    for frame, T in frames:
        T_sensor_model = T.copy()
        T_sensor_model[:3, 3] = T[:3, :3] @ shift + T[:3, 3]
        poses.append(StampedPose(frame.stamp_ns, T_sensor_model))
    return ScanResult(None, model, poses=poses, odometry=poses)
