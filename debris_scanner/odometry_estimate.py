"""What the odometry says of one frame."""

from dataclasses import dataclass

from debris_scanner.frames import KeyFrame
from debris_scanner.geometry import Array
from debris_scanner.registration import Agreement


@dataclass(frozen=True)
class OdometryEstimate:
    """What the filter says of one frame."""

    stamp_ns: int
    state: str
    accepted: bool  # the gate's verdict
    T_sensor_target: Array  # (4, 4)
    covariance: Array  # (6, 6): rotation, translation, sensor frame
    omega_target: Array  # (3,) rad/s
    omega_sigma: Array  # (3,) rad/s
    velocity: Array  # (3,) m/s, of the rotation centre, sensor frame
    agreement: Agreement
    observability: float | None  # None where nothing was registered
    keyframe: KeyFrame | None = None  # set when this frame became one
    missing: float = 0.0  # share of the reference's points beside the frame's silhouette
    sound: bool = True  # the whole side is seen, and where it is not told by its looks alone: fit for a model
    ambiguous: bool = False  # found again, but another attitude explains the frame as well
