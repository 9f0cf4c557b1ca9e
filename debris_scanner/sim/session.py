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

"""A simulated recording: settings in, frames with their true poses out."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import VIRTUAL_CAMERA, Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, log_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.io.files import write_atomically
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.io.trajectories import read_tum, write_tum
from debris_scanner.sim.clutter import (
    PLATE,
    STOOD_ON,
    hand_at_edge,
    make_clutter,
    make_desk,
    make_hand,
    on_plate,
)
from debris_scanner.sim.depth_sensor import KINECT, DepthSensor, SensorSettings
from debris_scanner.sim.image_filters import TemporalFilter, spatially_filtered, with_junk
from debris_scanner.sim.lighting import STRIPES, Lighting
from debris_scanner.sim.modelled_sensor import ModelledSensor
from debris_scanner.sim.motions import BY_HAND, INERTIA, SPIN, TUMBLES, MotionSettings, make_motion
from debris_scanner.sim.rays import PinholeRays
from debris_scanner.sim.sensors import DEFAULT_RANGE_M, KINECT1, SensorModel, find_sensor
from debris_scanner.sim.targets import Target, make_target, paint

FIRST_STAMP_NS = 1_000_000_000
TRUTH_POSES = 'truth.tum'
TRUTH_MESH = 'truth_mesh.ply'
ODOMETRY_RAD, ODOMETRY_M = float(np.radians(0.005)), 5e-5  # noise of the sensor's own odometry
SIMULATION = 'simulation.json'  # beside a truth without a recording: the frames can be rendered again

_OPTIONS = ('spatial_filter', 'temporal_filter', 'bump_px', 'junk_share', 'doubled', 'hand', 'focal_error')
_HAND_EVERY_S, _HAND_STAYS_S = 6.0, 1.0  # of a hand at the edge, which comes late

_Image = NDArray[np.uint16] | NDArray[np.float32]

_SECONDS = 25.0
_SECONDS_TUMBLE = 60.0
_SECONDS_BY_HAND = 45.0


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a recording. Equal settings give equal frames, bit for bit."""

    target: str = 'shuttle_stack'
    motion: str = SPIN
    seed: int = 0  # of the motion and of the noise
    rate_hz: float = 10.0  # frames a second
    seconds: float | None = None  # None: 25, or 60 for a tumble and 45 by hand
    size: float | None = None  # largest extent, m; None: the sensor's typical one, or the target's own
    spin_rad_s: float = 0.5  # negative turns the other way
    axis_sensor: tuple[float, float, float] | None = None  # None: 15 to 25 degrees off the vertical, by seed
    range_m: float | None = None  # distance of the target; None: the sensor's typical one
    gaps: bool = False  # out of sight for 1 to 3 s now and then
    gaps_from_s: float = 0.0  # no gap begins before
    patchy: bool = False  # now and then partially occluded
    leaves_s: float | None = None  # out of sight for good from then on
    mli: bool = False  # shiny insulation
    mli_share: float = 1.0  # of the surface that it covers
    noise: bool = True
    correlated: bool = False  # noise correlated over 4 pixels; of kinect1 alone
    clutter: str | None = None  # wall, table, object, or the desk or plate it stands on
    colour: bool = False  # beside the depth
    infrared: bool = False  # the echo of the sensor's own light, beside the depth; of clouds, their intensity
    paint: str = STRIPES  # of the target in these pictures: one of `lighting.PAINTS`
    light: str | None = None  # on its colours: one of `lighting.LIGHTS`
    sensor: str = KINECT1  # of `sensors`
    spin_about: str = 'z'  # which of the target's axes spins
    inertia: tuple[float, float, float] = INERTIA  # principal moments about the target's axes, any unit
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, target frame
    damping_s: float | None = None  # in which friction takes the rate to 1/e of it
    # in place of what the sensor's record has; None: as there, and without noise nothing
    spatial_filter: bool | None = None
    temporal_filter: bool | None = None
    bump_px: float | None = None
    junk_share: float | None = None
    doubled: bool | None = None
    hand: bool | None = None
    focal_error: float | None = None

    @property
    def duration_s(self) -> float:
        """Length of the recording."""
        if self.seconds is not None:
            return self.seconds
        if self.motion in TUMBLES:
            return _SECONDS_TUMBLE
        return _SECONDS_BY_HAND if self.motion == BY_HAND else _SECONDS


@dataclass(frozen=True)
class SimulatedFrame:
    """One frame and its truth: depth (h, w) in metres, 0 invalid; T_sensor_target (4, 4).

    A lidar's frame is its points; depth and camera are then what the scanner makes of an unorganised cloud.
    """

    stamp_ns: int
    depth: NDArray[np.float32]
    camera: Camera
    T_sensor_target: Array
    rgb: NDArray[np.uint8] | None = None  # (h, w, 3)
    infrared: NDArray[np.uint16] | None = None  # (h, w), of a lidar (n,)
    points: NDArray[np.float32] | None = None  # (n, 3) metres, sensor frame; None from a camera

    @property
    def picture(self) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
        """What it shows beside the depth: colours or brightness; None: nothing."""
        return self.infrared if self.rgb is None else self.rgb

    @property
    def depth_mm(self) -> NDArray[np.uint16]:
        """Depth (h, w) in whole millimetres, 0 invalid: exact of sensors that send 16UC1."""
        return np.rint(self.depth * np.float32(1000)).astype(np.uint16)


@dataclass(frozen=True)
class SensorSample:
    """One measurement of the sensor's own pose; covariance (6, 6) ordered (rotation, translation)."""

    stamp_ns: int
    T_world_sensor: Array
    covariance: Array


class Simulation:
    """The frames of one recording, made on demand; iterates any number of times, in any order."""

    def __init__(
        self, settings: SimulationSettings, target: Target | None = None, sensor: SensorModel | None = None
    ) -> None:
        """Build target, motion and sensor.

        Args:
            settings: of the recording.
            target: None for the one that the settings name.
            sensor: its record, likewise.

        Raises:
            ValueError: unknown target, motion, clutter or sensor, or numbers that make no recording.
        """
        self.settings = settings
        model = self.model = _with_options(sensor or find_sensor(settings.sensor), settings)
        range_m = model.range_m if settings.range_m is None else settings.range_m
        _check(settings, model, range_m)
        own = model.name == KINECT1
        # the Kinect's shifts and clutter are the same at all distances
        scale = 1.0 if own else range_m / DEFAULT_RANGE_M
        self.target = target or make_target(
            settings.target, model.size_m if settings.size is None else settings.size
        )
        self.motion = make_motion(_motion_settings(settings, range_m, scale))
        self._hand_leaves = np.zeros(3)
        hand, clutter = self._hand(range_m), self._clutter(scale)
        insulated = settings.mli_share if settings.mli else 0.0
        errors = SensorSettings(noise=settings.noise, correlated=settings.correlated, mli=insulated)
        self._sensor: DepthSensor | ModelledSensor = (
            DepthSensor(self.target, errors, settings.seed, KINECT, clutter, hand)
            if own
            else ModelledSensor(model, self.target, settings.seed, clutter, hand, settings.noise, insulated)
        )
        seed = settings.seed if settings.noise else None
        self._lighting = Lighting(self.target, model.rays, settings.paint, settings.light, seed)
        count = max(1, round(settings.duration_s * settings.rate_hz))
        self._ticks, self._jitter_ns = _arrivals(model if settings.noise else None, settings, count)
        self._average = -1, TemporalFilter.begin((model.rays.height, model.rays.width))  # after an image

    @property
    def camera(self) -> Camera:
        """The camera of every frame, as it is told; of a lidar that into which its clouds are projected."""
        true = self.model.rays.camera if isinstance(self.model.rays, PinholeRays) else VIRTUAL_CAMERA
        scale = 1 + self.model.focal_error
        return replace(true, fx=scale * true.fx, fy=scale * true.fy)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._ticks)

    def stamp_ns(self, index: int) -> int:
        """Stamp of a frame, after a start that is not zero.

        The multiple of the frame time at which the frame is taken, or comes again, and the sensor's jitter.
        """
        return self._at_ns(self._ticks[index]) + self._jitter_ns[index]

    def pose(self, index: int) -> Array:
        """True T_sensor_target (4, 4) of a frame, when it was taken."""
        return self.motion.T_sensor_target(self._time_s(index))

    def pose_at(self, stamp_ns: int) -> Array:
        """True T_sensor_target (4, 4) at a stamp; a tumble is known for a minute after the end."""
        return self.motion.T_sensor_target((stamp_ns - FIRST_STAMP_NS) * 1e-9)

    def sensor_odometry(self, rate_hz: float) -> list[SensorSample]:
        """What an odometry of the sensor says from the first frame to the last, with noise of its own."""
        rng = np.random.default_rng([self.settings.seed, 11])
        sigma = np.repeat([ODOMETRY_RAD, ODOMETRY_M], 3) * self.settings.noise
        samples = []
        for k in range(int(np.ceil(self.settings.duration_s * rate_hz)) + 1):
            T = inverse(self.motion.T_sensor_world(k / rate_hz))
            error = sigma * rng.normal(size=6)
            T = compose(T, transform(exp_so3(error[:3]), error[3:]))
            stamp_ns = FIRST_STAMP_NS + round(k * 1e9 / rate_hz)
            samples.append(SensorSample(stamp_ns, T, np.diag(sigma**2)))
        return samples

    def frame(self, index: int) -> SimulatedFrame:
        """The frame of an index in 0..len-1."""
        if not 0 <= index < len(self):
            raise IndexError(f'frame {index} of {len(self)}')
        pose = self.motion.T_sensor_target(self._time_s(index))
        seen, stamp = self._sent(index), self.stamp_ns(index)
        if isinstance(self._sensor, ModelledSensor) and self.model.sends_cloud:
            distance = np.asarray(seen, np.float32)
            points = self._sensor.points(distance)
            seen_as = DepthFrame.from_cloud(stamp, points)
            echo = self._echo(distance, pose, index)
            echo = None if echo is None else echo[distance > 0]
            return SimulatedFrame(stamp, seen_as.depth, seen_as.camera, pose, infrared=echo, points=points)
        millimetres = seen if seen.dtype == np.uint16 else seen * np.float64(1000)
        depth = seen * np.float32(0.001) if seen.dtype == np.uint16 else np.asarray(seen, np.float32)
        rgb = None
        if self.settings.colour and isinstance(self.model.rays, PinholeRays):
            if self.settings.light is None and self.settings.paint == STRIPES:
                rgb = paint(millimetres, self.model.rays.camera, pose)
            else:
                rgb = self._lighting.colours(depth, pose, self._time_s(index))
        return SimulatedFrame(stamp, depth, self.camera, pose, rgb, self._echo(depth, pose, index))

    def _echo(self, depth: NDArray[np.float32], pose: Array, index: int) -> NDArray[np.uint16] | None:
        return self._lighting.echo(depth, pose, self._time_s(index)) if self.settings.infrared else None

    def __iter__(self) -> Iterator[SimulatedFrame]:
        """All frames in order."""
        return (self.frame(i) for i in range(len(self)))

    def _sent(self, index: int) -> _Image:
        """The image (h, w) of a frame as the driver sends it: whole millimetres, or metres."""
        model = self.model
        if not (model.spatial_filter or model.temporal_filter or model.junk_share):
            return self._seen(index)
        depth = self._averaged(index) if model.temporal_filter else self._smoothed(index)
        if model.junk_share:
            rng = np.random.default_rng([self.settings.seed, 12, self._image(index)])
            depth = with_junk(depth, model.junk_share, rng)
        steps = np.rint(depth / np.float32(model.step_m))
        own = isinstance(self._sensor, DepthSensor)
        return steps.astype(np.uint16) if own else steps * np.float32(model.step_m)

    def _averaged(self, index: int) -> NDArray[np.float32]:
        """The image (h, w), metres, after a filter over all images so far: frames in order are quick."""
        done, state = self._average
        if done > self._image(index):
            done, state = -1, TemporalFilter.begin(state.seen.shape)
        for k in range(index + 1):
            if self._image(k) > done:
                done, state = self._image(k), state.after(self._smoothed(k))
        self._average = done, state
        return state.depth

    def _smoothed(self, index: int) -> NDArray[np.float32]:
        """The image (h, w), metres, after the filter within it, if there is one."""
        seen = self._seen(index)
        depth = np.asarray(seen * np.float32(0.001) if seen.dtype == np.uint16 else seen, np.float32)
        return spatially_filtered(depth) if self.model.spatial_filter else depth

    def _seen(self, index: int) -> _Image:
        """The image (h, w) of a frame as the sensor sees it."""
        t = self._time_s(index)
        pose, T_sensor_world = self.motion.T_sensor_target(t), self.motion.T_sensor_world(t)
        away = self.motion.hand_away(t)
        if self.settings.motion != BY_HAND and self.model.hand:
            away = float(t % _HAND_EVERY_S < _HAND_EVERY_S - _HAND_STAYS_S)
        hand = None if away == 1 else compose(T_sensor_world, transform(np.eye(3), away * self._hand_leaves))
        return self._sensor.render(pose, self._image(index), self.motion.visibility(t), T_sensor_world, hand)

    def _hand(self, range_m: float) -> Target | None:
        """The hand that turns the target, or one at the edge of the image."""
        vertices = apply(self.motion.T_sensor_target(0.0), self.target.vertices.astype(float))
        if self.settings.motion == BY_HAND:
            hand, self._hand_leaves = make_hand(vertices, self._axis())
            return hand
        rays = self.model.rays
        return hand_at_edge(vertices, range_m * rays.width / 2 / rays.focal_px) if self.model.hand else None

    def _clutter(self, scale: float) -> Target | None:
        """What stands around the target; with a plate the target itself gets it."""
        name = self.settings.clutter
        if name not in STOOD_ON:
            return make_clutter(name, scale) if name else None
        T, axis = self.motion.T_sensor_target(0.0), self._axis()
        if name == PLATE:
            self.target = on_plate(self.target, T, axis)
        return make_desk(apply(T, self.target.vertices.astype(float)), axis)

    def _axis(self) -> Array:
        """Axis (3,), unit, of the target's first turn."""
        R = [self.motion.T_sensor_target(t)[:3, :3] for t in (0.0, 0.1, 2.5)]
        for later in R[1:]:  # a hand waits first
            axis = log_so3(later @ R[0].T)
            if np.linalg.norm(axis) > 0:
                return np.asarray(axis / np.linalg.norm(axis))
        raise ValueError('a target that stands on something turns about an axis: choose --motion spin')

    def _image(self, index: int) -> int:
        """Tick at which the image of a frame was taken."""
        tick = self._ticks[index]
        return tick - tick % 2 if self.model.doubled else tick

    def _at_ns(self, tick: int) -> int:
        return FIRST_STAMP_NS + round(tick * 1e9 / self.settings.rate_hz)

    def _time_s(self, index: int) -> float:
        return (self._at_ns(self._image(index)) - FIRST_STAMP_NS) * 1e-9


def _check(settings: SimulationSettings, model: SensorModel, range_m: float) -> None:
    """Raise ValueError where the numbers make no recording."""
    rate_hz, duration_s, spin = settings.rate_hz, settings.duration_s, settings.spin_rad_s
    if not (0 < rate_hz < np.inf and 0 < duration_s < np.inf):
        raise ValueError(f'rate and length must be positive, not {rate_hz!r} Hz and {duration_s!r} s')
    if not (0.1 <= range_m <= 20 and np.isfinite(spin)):
        raise ValueError(
            f'range must be 0.1 to 20 m and the spin finite, not {range_m!r} m and {spin!r} rad/s'
        )
    if settings.correlated and model.name != KINECT1:
        raise ValueError(f'correlated noise is an option of {KINECT1}: {model.name} has noise of its own')
    if settings.colour and model.sends_cloud:
        raise ValueError(f'{model.name} sends clouds, and colour needs a depth image')
    if settings.colour and settings.infrared:
        raise ValueError('one picture lies beside the depth: colour or infrared, not both')
    if settings.light is not None and not settings.colour:
        raise ValueError("a lamp lights a picture in colour; infrared is the echo of the sensor's own light")
    if not 0 <= settings.mli_share <= 1:
        raise ValueError(f'the share of the insulation must be from 0 to 1, not {settings.mli_share!r}')
    if settings.seed < 0:
        raise ValueError(f'the seed must not be negative: {settings.seed}')


def _motion_settings(settings: SimulationSettings, range_m: float, scale: float) -> MotionSettings:
    return MotionSettings(
        settings.motion,
        settings.spin_rad_s,
        settings.axis_sensor,
        range_m,
        settings.seed,
        settings.duration_s,
        settings.gaps,
        settings.gaps_from_s,
        settings.patchy,
        settings.leaves_s,
        scale,
        settings.spin_about,
        settings.inertia,
        settings.centre_of_mass,
        settings.damping_s,
        from_above=settings.clutter in STOOD_ON,
    )


def _with_options(model: SensorModel, settings: SimulationSettings) -> SensorModel:
    """A sensor's record with what the settings have in its place.

    Raises:
        ValueError: the sensor has no such thing.
    """
    own = {name: getattr(model, name) for name in _OPTIONS}
    plain = {name: type(value)() for name, value in own.items()}  # without noise nothing is added
    given = {name: value for name in _OPTIONS if (value := getattr(settings, name)) is not None}
    chosen = (own if settings.noise else plain) | given
    if model.sends_cloud and any(given.values()):
        raise ValueError(f'{model.name} sends clouds, and {", ".join(sorted(given))} is of depth images')
    if given.get('bump_px') and not (model.baseline_m and model.name != KINECT1):
        raise ValueError(f'a pattern in disparity is of a stereo camera: {model.name} has none')
    if not (0 <= chosen['junk_share'] <= 1 and chosen['bump_px'] >= 0 and abs(chosen['focal_error']) < 1):
        raise ValueError('shares of junk and focal error must be below 1, and the pattern not negative')
    return replace(model, **chosen)


def _arrivals(
    model: SensorModel | None, settings: SimulationSettings, count: int
) -> tuple[list[int], list[int]]:
    """Numbers of the frames that arrive, of those taken, and the jitter of their stamps, ns."""
    ticks = np.arange(count)
    if model is None:
        return ticks.tolist(), [0] * count
    rng = np.random.default_rng([settings.seed, 9])
    arrives = rng.random(count) >= model.frame_loss
    arrives[0] = True
    # stamps stay in order
    bound = 0.4 / settings.rate_hz
    jitter = np.clip(rng.normal(0.0, model.jitter_s, count), -bound, bound)[arrives]
    return ticks[arrives].tolist(), np.rint(jitter * 1e9).astype(np.int64).tolist()


def simulate(settings: SimulationSettings) -> Simulation:
    """The recording of these settings: ``len()`` counts its frames, iterating renders them."""
    return Simulation(settings)


def write_truth(folder: Path, stamps_ns: Sequence[int], poses: Sequence[Array], target: Target) -> None:
    """Write ``truth.tum`` and ``truth_mesh.ply`` beside a recording; the mesh of an empty scene is empty.

    Args:
        folder: of the recording; made where missing.
        stamps_ns: of the frames.
        poses: T_sensor_target (4, 4) of the frames.
        target: its mesh is the truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_tum(folder / TRUTH_POSES, [StampedPose(s, T) for s, T in zip(stamps_ns, poses, strict=True)])
    write_mesh_ply(folder / TRUTH_MESH, target.vertices, target.triangles)


def write_settings(folder: Path, settings: SimulationSettings) -> None:
    """Write ``simulation.json`` beside the truth of frames that are recorded nowhere."""
    values = asdict(settings)
    if (mesh := Path(settings.target)).is_file():
        values['target'] = str(mesh.resolve())
    write_atomically(folder / SIMULATION, (json.dumps(values, indent=2) + '\n').encode())


def read_settings(folder: Path) -> SimulationSettings:
    """The inverse of :func:`write_settings`.

    Raises:
        ValueError: the file is unreadable.
    """
    path = folder / SIMULATION
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
        given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return SimulationSettings(**given)
    except (OSError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f'{path} does not hold the settings of a simulation: {error}') from error


def frames_again(simulation: Simulation, truth_dir: Path) -> Iterator[DepthFrame]:
    """The frames that a simulated camera sent, rendered again, with the stamps that it gave them."""
    for k, pose in enumerate(read_tum(truth_dir / TRUTH_POSES)):
        frame = simulation.frame(k)
        yield DepthFrame(pose.stamp_ns, frame.depth, frame.camera)
