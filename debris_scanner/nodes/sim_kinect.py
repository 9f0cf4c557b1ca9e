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

"""Node ``sim_kinect``: simulates a depth sensor in real time, and writes its truth to disk."""

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import ParameterError
from debris_scanner.io.result_files import check_output_dir
from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, INFO, POINTS
from debris_scanner.nodes.inputs.sources import Due, SourceNode
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare, declare_path
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import DEFAULT_SENSOR_FRAME
from debris_scanner.sim.lighting import LIGHTS, PAINTS
from debris_scanner.sim.sensors import SENSOR_NAMES
from debris_scanner.sim.session import (
    SimulatedFrame,
    Simulation,
    SimulationSettings,
    write_settings,
    write_truth,
)
from msg_adapters.clouds import xyz_message
from msg_adapters.colour_images import colour_image_message
from msg_adapters.depth_images import camera_info_message, depth_image_message
from msg_adapters.stamps import header_message

OWN = "; false or 0: the sensor's own"  # of what a driver, a recorder or people add


class SimKinectNode(SourceNode):
    """``depth/image_raw`` and ``depth/camera_info``, or a lidar's ``points``, stamped with the wall clock.

    Stamps are multiples of the frame period after the start, so a frame shows the target as it was at its
    stamp; those of other sensors than ``kinect1`` jitter, and some of their frames are lost. Truth is written
    to ``truth_dir`` at the end, never into a message.
    """

    def __init__(self) -> None:
        super().__init__('sim_kinect')
        settings = declared_settings(self)
        self._truth_dir = declare_path(
            self, 'truth_dir', 'folder for truth.tum, truth_mesh.ply and simulation.json; empty: none'
        )
        self._frame_id = declare(self, 'frame_id', DEFAULT_SENSOR_FRAME, 'optical frame of the sensor')
        if self._truth_dir is not None:
            check_output_dir(self._truth_dir)
        try:
            self._simulation = Simulation(settings)
        except ValueError as error:
            raise ParameterError(str(error)) from None
        self._stamps: list[int] = []
        self._poses: list[Array] = []
        if self._simulation.model.sends_cloud:
            self._points = self.create_publisher(PointCloud2, POINTS, qos.cloud_publisher())
            self.play(self._clouds(), (self._points,))
            return
        self._image = self.create_publisher(Image, DEPTH, qos.cloud_publisher())
        self._info = self.create_publisher(CameraInfo, INFO, qos.waiting())
        self._colour = (
            self.create_publisher(Image, COLOUR, qos.cloud_publisher())
            if settings.colour or settings.infrared
            else None
        )
        self.play(self._images(), (self._image, self._info))

    def close(self) -> None:
        """Stop, and write the truth of the frames sent."""
        super().close()
        if self._truth_dir is not None:
            write_truth(self._truth_dir, self._stamps, self._poses, self._simulation.target)
            write_settings(self._truth_dir, self._simulation.settings)

    def _images(self) -> Iterator[Due]:
        encoding = self._simulation.model.encoding
        for frame in self._simulation:
            # what needs no stamp is made before the frame is due
            image = depth_image_message(0, self._frame_id, frame.depth, encoding)

            def send(stamp_ns: int, frame: SimulatedFrame = frame, image: Image = image) -> None:
                self._info.publish(camera_info_message(stamp_ns, self._frame_id, frame.camera))
                image.header = header_message(stamp_ns, self._frame_id)
                self._image.publish(image)
                if self._colour is not None and frame.picture is not None:
                    self._colour.publish(colour_image_message(stamp_ns, self._frame_id, frame.picture))
                self._note(stamp_ns, frame)

            yield self._due(frame, send)

    def _clouds(self) -> Iterator[Due]:
        for frame in self._simulation:
            assert frame.points is not None
            cloud = xyz_message(0, self._frame_id, frame.points, frame.infrared)

            def send(stamp_ns: int, frame: SimulatedFrame = frame, cloud: PointCloud2 = cloud) -> None:
                cloud.header = header_message(stamp_ns, self._frame_id)
                self._points.publish(cloud)
                self._note(stamp_ns, frame)

            yield self._due(frame, send)

    def _due(self, frame: SimulatedFrame, send: Callable[[int], None]) -> Due:
        return Due((frame.stamp_ns - self._simulation.stamp_ns(0)) * 1e-9, send, is_frame=True)

    def _note(self, stamp_ns: int, frame: SimulatedFrame) -> None:
        self._stamps.append(stamp_ns)
        self._poses.append(frame.T_sensor_target)


def declared_settings(node: Node) -> SimulationSettings:
    """The fields of SimulationSettings as parameters; zero or empty stands for None."""
    return SimulationSettings(**_declared_motion(node), **_declared_sensor(node))


def _declared_motion(node: Node) -> dict[str, Any]:
    """Of the target, its motion, and when it is seen."""
    d = SimulationSettings()
    axis = declare(
        node, 'axis_sensor', [0.0, 0.0, 0.0], 'spin axis in the sensor frame; 0 0 0: chosen by the seed'
    )
    inertia = declare(
        node, 'inertia', list(d.inertia), "principal moments about the target's x, y and z, any unit"
    )
    centre = declare(
        node, 'centre_of_mass', list(d.centre_of_mass), "about which a tumble turns, m, target's frame"
    )
    typical = "the sensor's typical one"
    return {
        'target': declare(node, 'target', d.target, 'target by name, or a mesh file'),
        'motion': declare(node, 'motion', d.motion, 'motion of the target'),
        'seconds': declare(node, 'seconds', 0.0, 'length of the recording, s; 0: 25, or 60 for a tumble', 0.0)
        or None,
        'size': declare(node, 'size', 0.0, f'largest extent of the target, m; 0: {typical}', 0.0) or None,
        'spin_rad_s': declare(node, 'spin_rad_s', d.spin_rad_s, 'rate of the spin, rad/s'),
        'axis_sensor': _three('axis_sensor', axis) if any(axis) else None,
        'range_m': declare(
            node, 'range_m', 0.0, f'distance of the target, m, from 0.1; 0: {typical}', 0.0, 20.0
        )
        or None,
        'gaps': declare(node, 'gaps', d.gaps, 'out of sight for 1 to 3 s now and then'),
        'gaps_from_s': declare(node, 'gaps_from_s', d.gaps_from_s, 'earliest begin of a gap, s'),
        'patchy': declare(node, 'patchy', d.patchy, 'partially occluded for 1 to 3 s now and then'),
        'leaves_s': declare(node, 'leaves_s', 0.0, 'the target leaves for good, s; 0: never', 0.0) or None,
        'spin_about': declare(
            node, 'spin_about', d.spin_about, "which of the target's axes spins: x, y or z"
        ),
        'inertia': _three('inertia', inertia),
        'centre_of_mass': _three('centre_of_mass', centre),
        'damping_s': declare(
            node, 'damping_s', 0.0, 'friction takes the rate to 1/e in this time, s; 0: none', 0.0
        )
        or None,
    }


def _declared_sensor(node: Node) -> dict[str, Any]:
    """Of the sensor, its noise, and what else it sees."""
    d = SimulationSettings()
    clutter = declare(node, 'clutter', '', 'static background: wall, table, object or desk; empty: none')
    own = {
        'spatial_filter': declare(node, 'spatial_filter', False, f'smooth images up to their edges{OWN}'),
        'temporal_filter': declare(node, 'temporal_filter', False, f'average images over time{OWN}'),
        'bump_px': declare(node, 'bump_px', 0.0, f'RMS of a pattern fixed in the image, px{OWN}', 0.0),
        'junk_share': declare(node, 'junk_share', 0.0, f'share of pixels said to be far away{OWN}', 0.0, 1.0),
        'doubled': declare(node, 'doubled', False, f'each image comes twice{OWN}'),
        'hand': declare(node, 'hand', False, f'now and then a hand at the edge of the image{OWN}'),
        'focal_error': declare(
            node, 'focal_error', 0.0, f'of the focal lengths in camera_info, a share{OWN}'
        ),
    }
    return {
        'seed': declare(node, 'seed', d.seed, 'random seed of motion and noise', 0),
        'rate_hz': declare(node, 'rate_hz', d.rate_hz, 'frames a second', 0.1, 1000.0),
        'mli': declare(node, 'mli', d.mli, 'shiny multi-layer insulation: holes and outliers'),
        'mli_share': declare(node, 'mli_share', d.mli_share, 'share of the surface that it covers'),
        'noise': declare(node, 'noise', d.noise, 'sensor noise'),
        'correlated': declare(node, 'correlated', d.correlated, 'noise correlated over 4 pixels, of kinect1'),
        'clutter': clutter or None,
        'colour': declare(node, 'colour', d.colour, 'publish a painted target on rgb/image_raw, too'),
        'infrared': declare(node, 'infrared', d.infrared, "publish the echo of the sensor's own light there"),
        'paint': declare(node, 'paint', d.paint, f'of the target: {", ".join(PAINTS)}'),
        'light': declare(node, 'light', '', f'on its colours: {", ".join(LIGHTS)}; empty: an even light')
        or None,
        'sensor': declare(node, 'sensor', d.sensor, f'simulated sensor: {", ".join(SENSOR_NAMES)}'),
        **{name: value or None for name, value in own.items()},
    }


def _three(name: str, values: Sequence[float]) -> tuple[float, float, float]:
    if len(values) != 3:
        raise ParameterError(f'{name} needs 3 values, got {list(values)}')
    return (values[0], values[1], values[2])


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner sim_kinect``."""
    return run(SimKinectNode, args, images=True)


if __name__ == '__main__':
    sys.exit(main())
