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

"""Node ``preprocess``: isolates the target in the sensor's clouds or depth images."""

import sys
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from debris_scanner.core.frames import DepthFrame
from debris_scanner.io.recent_frames import RecentFrames
from debris_scanner.nodes.inputs.sensor_input import SensorInput, input_values
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import HINT, UNITS, WARN, Problem, together
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters, declare_settings
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import PAUSED_TOPIC
from debris_scanner.nodes.recovery.catching_up import declare_journal, journal_folder
from debris_scanner.sensing.hints import given, joined
from debris_scanner.settings import Settings
from debris_scanner.stages import make_preprocessor
from debris_scanner.warm_up import warm_up
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import target_frame_message

PAUSED = 'paused'
GROUPS, LIVE = ('isolation', 'normals'), ('isolation',)


class PreprocessNode(ManagedNode):
    """Decode, isolate the target, fit normals; ``points`` or ``depth/image_raw`` to ``target_points``."""

    def __init__(self) -> None:
        super().__init__('preprocess')

    def declare_parameters_of_stage(self) -> None:
        """The settings and parameters of all that :meth:`setup` makes."""
        declare_settings(self, GROUPS, LIVE)
        declare_journal(self)
        SensorInput.declare(self)

    def setup(self) -> None:
        """Make all but the lifecycle's own parameters; messages are processed once the node is active."""
        self.settings = SettingsParameters(self, GROUPS, LIVE, self._apply)
        self.preprocessor = make_preprocessor(self.settings.value, self.timer)
        self.paused = False
        warm_up('preprocess')
        self._publisher = self.create_publisher(PointCloud2, 'target_points', qos.cloud_publisher())
        self.diagnostics.expect_subscribers(2, target_points=self._publisher)  # odometry and graph
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_subscription(Bool, PAUSED_TOPIC, lambda msg: self._pause(msg.data), qos.latched())
        self.offer_reset()
        folder = journal_folder(self)
        self._recent = None if folder is None else RecentFrames(folder)  # for stages that restart
        self.input = SensorInput(self, self._process)
        # what it has done tells what it keeps up with
        self.create_subscription(Odometry, 'odometry', self._on_odometry, qos.recent())

    def diagnostic_values(self) -> dict[str, Any]:
        """Lost inputs, corrections of their stamps, and what is odd about them."""
        return input_values(self.input) | {
            HINT: joined(*self.hints),
            UNITS: self.preprocessor.unit_warning,
        }

    @property
    def hints(self) -> tuple[str, ...]:
        """What is odd about the input, if most of its frames are of no use."""
        return given(self.input.hint, *self.preprocessor.hints)

    def problem(self) -> Problem | None:
        """A silent sensor, an odd input, frames that cannot be stored, or background in the box."""
        if self._recent is not None and self._recent.problem:
            return WARN, self._recent.problem
        if self.paused:
            return None
        odd = self.input.oddity(self.hints)
        warnings = (self.preprocessor.background_warning, self.preprocessor.unit_warning)
        return together(self.input.problem(), odd, *((WARN, text) for text in warnings))

    def teardown(self) -> None:
        """Forget the scan."""
        self.reset_stage()

    def reset_stage(self) -> None:
        """Forget the target and all counts."""
        super().reset_stage()
        self.preprocessor.reset()
        self.input.reset()
        if self._recent is not None:
            self._recent.restart()

    def _on_odometry(self, msg: Odometry) -> None:
        self.input.answered(read_stamp(msg.header.stamp))

    def _process(self, frame: DepthFrame, frame_id: str) -> bool:
        """Publish the target of a frame; False if there is none."""
        if self.paused:
            self.diagnostics.rejected[PAUSED] += 1
            return False
        target = self.preprocessor.process(frame)
        if self._recent is not None:
            with self.timer.stage('journal'):
                self._recent.append(target, frame_id)
        with self.timer.stage('encode'):
            self._publisher.publish(target_frame_message(target, frame_id))
        self.diagnostics.counts['published'] += 1
        return True

    def _apply(self, settings: Settings) -> None:
        self.preprocessor.configure(settings.isolation)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._pause(request.data)
        response.success = True
        response.message = 'paused: frames are dropped' if self.paused else 'frames are let through'
        return response

    def _pause(self, paused: bool) -> None:
        if paused != self.paused:
            self.get_logger().info('paused' if paused else 'resumed')
        self.paused = paused


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner preprocess``."""
    return run(PreprocessNode, args)


if __name__ == '__main__':
    sys.exit(main())
