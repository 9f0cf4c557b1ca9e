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

"""The sensors of the simulator: what each one sees, and how it errs, as one record a sensor.

Sources, named by author and year at each figure:

- Khoshelham and Elberink 2012, Accuracy and resolution of Kinect depth data for indoor mapping applications.
- Nguyen, Izadi and Lovell 2012, Modeling Kinect sensor noise for improved 3D reconstruction and tracking.
- Fankhauser et al. 2015, Kinect v2 for mobile robot navigation: evaluation and modeling.
- Lachat et al. 2015, Assessment and calibration of a RGB-D camera (Kinect v2).
- Keselman et al. 2017, Intel RealSense stereoscopic depth cameras.
- Grunnet-Jepsen, Sweetser and Woodfill 2018, Tuning depth cameras for best performance (Intel).
- Ahn et al. 2019, Analysis and noise modeling of the Intel RealSense D435 for mobile robots.
- Tölgyessy et al. 2021, Evaluation of the Azure Kinect and its comparison to Kinect V1 and Kinect V2.
- Cai et al. 2024, Noise analysis and modeling of the PMD Flexx2 depth camera.
- the makers' data sheets: Intel D400 series 2023, Microsoft Azure Kinect DK 2019, pmd CamBoard pico flexx
  2017, Livox HAP 2022.

"Ours" marks a round figure that no source gives: of the order that a scan of real recordings suggests.
"""

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.parameters import did_you_mean
from debris_scanner.sim.depth_sensor import BASELINE_M, DISPARITY_STEP_PX, KINECT
from debris_scanner.sim.rays import AngularRays, PinholeRays

KINECT1 = 'kinect1'  # the default: its errors are those of `depth_sensor`, not of its record
DEFAULT_RANGE_M = 0.8  # of that Kinect; motions and clutter are made for it


@dataclass(frozen=True)
class SensorModel:
    """Geometry and errors of one sensor. Depth is along z for cameras, along the ray for a lidar."""

    name: str
    rays: PinholeRays | AngularRays
    range_m: float  # typical distance of the target
    limits_m: tuple[float, float]  # nothing is measured nearer or farther
    size_m: float | None = None  # target's largest extent by default; None: its own

    # random noise, drawn anew in each frame
    axial: tuple[float, float, float] = (
        0.0,
        0.0,
        0.0,
    )  # c0, c1, c2: sigma = c0 + c1 z + c2 z^2, facing, metres
    oblique_px: float = 0.0  # sigma of a slope: this many pixels' footprint times tan(incidence)
    correlation_px: float = 0.0  # lag at which the noise's correlation falls to 1/e
    jagged_px: float = 0.0  # standard deviation of an edge's place

    # patterns fixed in the image, the same in all frames
    bump_px: float = 0.0  # RMS in disparity: bumps grow with depth^2
    bump_length_px: float = 30.0  # lag at which their correlation falls to 1/e
    offset_share: float = 0.0  # RMS of a slow offset, as a share of the depth
    offset_length_px: float = 100.0

    # no return, or a wrong one
    baseline_m: float = 0.0  # projector or second camera on +x: what it does not see gives nothing
    second_image: bool = False  # the second eye is a camera with the same image, whose border cuts the view
    edge_dropout: float = 0.0  # share of the pixels at a depth edge that return nothing
    flying: float = 0.0  # share of the pixels at a depth edge that mix near and far
    grazing_cosine: float = 0.25  # below this cosine of incidence returns thin out, to none at a third of it

    # output
    disparity_step_px: float = 0.0  # 0: depth is not quantised in disparity
    step_m: float = 0.001  # of the depth sent; below a millimetre it is sent as 32FC1
    frame_loss: float = 0.01  # share of the frames that never arrive
    jitter_s: float = 0.0015  # standard deviation of the stamps

    # what driver, recorder and people add; see `image_filters`
    spatial_filter: bool = False
    temporal_filter: bool = False
    junk_share: float = 0.0  # of the pixels, that are said to be far away
    doubled: bool = False  # each image comes twice: the recorder polls faster than the sensor
    hand: bool = False  # now and then one is seen at the edge of the image
    focal_error: float = 0.0  # of the focal lengths in camera_info, as a share

    @property
    def sends_cloud(self) -> bool:
        """Whether frames are unorganised clouds instead of depth images."""
        return isinstance(self.rays, AngularRays)

    @property
    def encoding(self) -> Literal['16UC1', '32FC1']:
        """Of its depth images."""
        return '16UC1' if self.step_m >= 0.001 else '32FC1'

    def sigma(self, depth: NDArray[np.float32], cosine: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standard deviation (h, w) of a frame's noise, metres, at depths and cosines of incidence."""
        c0, c1, c2 = (np.float32(c) for c in self.axial)
        cosine = np.clip(cosine, np.float32(0.05), np.float32(1))
        slope = np.sqrt(1 - cosine**2) / cosine
        footprint = depth * np.float32(self.oblique_px / self.rays.focal_px)
        return np.hypot(c0 + c1 * depth + c2 * depth**2, footprint * slope)


def _camera(focal: float, width: int, height: int) -> PinholeRays:
    return PinholeRays(Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height))


def _stereo(focal: float, baseline_m: float, subpixel: float) -> tuple[float, float, float]:
    """Axial law of triangulation: sigma = subpixel z^2 / (focal baseline); Keselman et al. 2017."""
    return 0.0, 0.0, subpixel / (focal * baseline_m)


_KINECT1 = SensorModel(
    KINECT1, PinholeRays(KINECT), DEFAULT_RANGE_M, (0.0, 65.0), frame_loss=0.0, jitter_s=0.0
)

_KINECT1_REAL = SensorModel(
    'kinect1_real',
    PinholeRays(KINECT),
    DEFAULT_RANGE_M,
    (0.4, 5.0),  # Khoshelham and Elberink 2012: up to 5 m
    axial=(0.001504, -0.00152, 0.0019),  # 0.0012 + 0.0019 (z - 0.4)^2, Nguyen et al. 2012
    oblique_px=0.5,  # their sigma at 60 degrees and 0.8 m: 1.95 mm
    correlation_px=4.0,  # ours: disparity is matched by windows of several pixels
    jagged_px=0.5,  # Nguyen et al. 2012: lateral noise 0.8 px and more; ours is less
    baseline_m=BASELINE_M,  # Khoshelham and Elberink 2012: 75 mm; the projector is on the right
    edge_dropout=0.3,  # ours
    disparity_step_px=DISPARITY_STEP_PX,  # Khoshelham and Elberink 2012: 1/8 pixel
)

_KINECT2 = SensorModel(
    'kinect2',
    _camera(366.0, 512, 424),
    1.2,
    (0.5, 4.5),  # Fankhauser et al. 2015
    axial=(0.0015, -0.0005, 0.0003),  # 1.5 - 0.5 z + 0.3 z^2 mm, Fankhauser et al. 2015, indoors
    oblique_px=0.25,  # their 0.1 z^1.5 a^2 / (pi/2 - a)^2 mm at a = 60 degrees and 1.2 m
    correlation_px=1.5,  # ours: the driver's bilateral filter
    jagged_px=0.4,  # Fankhauser et al. 2015: lateral noise 1.6 mm, half a pixel at 1.2 m
    offset_share=0.0035,  # Lachat et al. 2015: errors that swing over a few metres by about a centimetre
    offset_length_px=100.0,  # ours
    edge_dropout=0.2,  # ours: the driver's edge filter
    flying=0.3,  # Tölgyessy et al. 2021 shows them; the share is ours
    grazing_cosine=0.2,  # ours
)

_D435 = SensorModel(
    'd435',
    _camera(424.0, 848, 480),  # 90 degrees across: Intel 2023
    0.8,
    (0.2, 10.0),  # Intel 2023: 195 mm at 848 x 480
    axial=_stereo(
        424.0, 0.05, 0.08
    ),  # Grunnet-Jepsen et al. 2018: 0.08 px and less is good; 50 mm, Intel 2023
    oblique_px=0.5,  # Ahn et al. 2019 measure a growth with incidence; the figure is ours
    correlation_px=5.0,  # ours: the matching window
    jagged_px=0.5,  # ours
    bump_px=0.05,  # Keselman et al. 2017 name the pattern's fixed error; the figure is ours
    bump_length_px=30.0,  # ours
    baseline_m=0.05,  # Intel 2023; depth is that of the left camera
    second_image=True,
    edge_dropout=0.3,  # ours
    disparity_step_px=1 / 32,  # Keselman et al. 2017: five bits of subpixel
)

_D405 = dataclasses.replace(
    _D435,
    name='d405',
    rays=_camera(430.0, 848, 480),  # Intel 2023: 87 degrees across, rounded
    range_m=0.25,
    limits_m=(0.07, 0.5),  # Intel 2023
    size_m=0.1,
    axial=_stereo(430.0, 0.018, 0.08),
    baseline_m=0.018,  # Intel 2023
    step_m=0.0001,  # Intel 2023: its unit of depth is 0.1 mm
)

_AZURE = SensorModel(
    'azure',
    _camera(504.0, 640, 576),
    1.0,
    (0.5, 3.86),  # NFOV unbinned, Microsoft 2019
    axial=(
        0.0007,
        0.0,
        0.0003,
    ),  # ours: 1 mm at 1 m and 4.4 mm at 3.5 m; Tölgyessy et al. 2021: at most 17 mm
    oblique_px=0.25,  # as kinect2
    correlation_px=1.5,  # ours
    jagged_px=0.4,  # ours
    offset_share=0.003,  # Microsoft 2019, confirmed by Tölgyessy et al. 2021: below 11 mm at 3.5 m
    offset_length_px=150.0,  # ours
    edge_dropout=0.3,  # Tölgyessy et al. 2021: most pixels that would fly are made invalid; the share is ours
    flying=0.2,  # ours
    grazing_cosine=0.2,  # ours
)

_FLEXX = SensorModel(
    'flexx',
    _camera(210.0, 224, 171),  # pmd 2017: 62 degrees across is 186 px, a lens of 56 degrees is modelled
    0.6,
    (0.1, 4.0),  # pmd 2017
    axial=(0.0, 0.006, 0.0),  # pmd 2017: at most 1 % of the distance at 5 frames a second
    oblique_px=0.3,  # Cai et al. 2024 measure a growth with incidence; the figure is ours
    correlation_px=1.5,  # ours
    jagged_px=0.4,  # ours
    offset_share=0.004,  # ours
    offset_length_px=50.0,  # ours
    edge_dropout=0.2,  # ours
    flying=0.4,  # pmd 2017 describes them; the share is ours
    grazing_cosine=0.2,  # ours
)

_TOF_SPACE = SensorModel(
    'tof_space',
    _camera(260.0, 320, 240),
    8.0,
    (0.5, 15.0),  # ours: a camera for rendezvous
    size_m=4.0,
    axial=(0.0, 0.0, 0.00023),  # ours: 15 mm at 8 m, and shot noise that grows as light fades, with z^2
    oblique_px=0.3,  # ours
    correlation_px=1.5,  # ours
    jagged_px=0.4,  # ours
    offset_share=0.003,  # ours
    offset_length_px=80.0,  # ours
    edge_dropout=0.2,  # ours
    flying=0.4,  # ours
    grazing_cosine=0.2,  # ours
)

_LIDAR = SensorModel(
    'lidar',
    AngularRays(float(np.radians(0.18)), 340, 250),  # ours: 61 x 45 degrees, without rotating parts
    8.0,
    (0.5, 100.0),  # Livox 2022: blind below 0.5 m
    size_m=4.0,
    axial=(0.015, 0.0, 0.0),  # Livox 2022: below 20 mm at 20 m
    oblique_px=0.2,  # ours: the beam's footprint
    jagged_px=0.3,  # Livox 2022: angular error below 0.1 degrees, half a pixel
    offset_share=0.0015,  # Livox 2022: systematic error below 30 mm at 20 m
    offset_length_px=80.0,  # ours
    edge_dropout=0.1,  # ours
    flying=0.25,  # ours: a beam of 0.03 to 0.28 degrees, Livox 2022
    grazing_cosine=0.1,  # ours
)

_D415_REAL = dataclasses.replace(
    _D435,
    name='d415_real',
    rays=_camera(612.0, 640, 480),  # ours: aligned to the colour image, as recorders send it
    range_m=0.6,
    limits_m=(0.3, 10.0),  # Intel 2023: from 0.31 m at 640 x 480
    axial=_stereo(612.0, 0.055, 0.08),
    # ours, of recordings: a wall at half a metre is 0.5 to 1.1 mm off a plane, rms, in all frames alike; that
    # is 0.06 to 0.15 px, and falls to 1/e over some ten pixels
    bump_px=0.12,
    bump_length_px=10.0,
    baseline_m=0.055,  # Intel 2023
    spatial_filter=True,
    temporal_filter=True,
    junk_share=0.0003,  # ours, of recordings: some hundred pixels of an image
    doubled=True,  # ours, of recordings: half of the successive pairs
    hand=True,
    focal_error=0.02,  # ours
)

SENSORS = {
    model.name: model
    for model in (
        _KINECT1,
        _KINECT1_REAL,
        _KINECT2,
        _D435,
        _D405,
        _AZURE,
        _FLEXX,
        _TOF_SPACE,
        _LIDAR,
        _D415_REAL,
    )
}
SENSOR_NAMES = tuple(SENSORS)


def find_sensor(name: str) -> SensorModel:
    """The record of the named sensor.

    Raises:
        ValueError: unknown name.
    """
    if name not in SENSORS:
        raise ValueError(
            f'unknown sensor {name!r}: choose one of {", ".join(SENSOR_NAMES)}'
            f'{did_you_mean(name, SENSOR_NAMES)}'
        )
    return SENSORS[name]
