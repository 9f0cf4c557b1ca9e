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

"""Services of the node that owns the scan: generate_model, reset, save_model, finish, pause."""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Bool, Empty
from std_srvs.srv import SetBool, Trigger

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.stage import PAUSED_TOPIC, RESET_TOPIC
from debris_scanner.nodes.lifecycle.worker import Job
from debris_scanner.nodes.scan.scan_thread import ScanThread


class ScanServices:
    """Answers a request when its work is done; the executor keeps spinning meanwhile.

    Args:
        node: that offers the services.
        scan: whose thread does the work.
        before_reset: called before the reset is published; removes the journals of nodes that miss it.
    """

    def __init__(self, node: Node, scan: ScanThread, before_reset: Callable[[], None] = lambda: None) -> None:
        self._before_reset = before_reset
        self._reset = node.create_publisher(Empty, RESET_TOPIC, qos.waiting())
        self._paused = node.create_publisher(Bool, PAUSED_TOPIC, qos.latched())
        for name, ask in (
            ('generate_model', lambda: scan.worker.ask(scan.generate_now)),
            ('save_model', lambda: scan.worker.ask(scan.save_now)),
            ('finish', scan.ask_to_finish),
        ):
            # a callback group each: a callback that waits blocks the others of its group
            node.create_service(
                Trigger, f'~/{name}', _worked(ask), callback_group=MutuallyExclusiveCallbackGroup()
            )
        node.create_service(Trigger, '~/reset', self._on_reset)
        node.create_service(SetBool, '~/pause', self._on_pause)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._before_reset()
        self._reset.publish(Empty())  # this node receives it, too
        response.success, response.message = True, 'all nodes start a new scan'
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused.publish(Bool(data=request.data))
        response.success = True
        response.message = 'paused: frames are dropped' if request.data else 'resumed'
        return response


def _worked(ask: Callable[[], Job]) -> Any:
    async def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = await ask()
        return response

    return answer
