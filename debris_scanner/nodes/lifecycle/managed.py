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

"""Lifecycle of the nodes of a scan: configure, activate, deactivate, cleanup, shutdown.

A node configures and activates itself; with ``autostart:=false`` it waits for a lifecycle manager. Its
topics, services and timers exist from configure to cleanup, its parameters from the start. Those that a
running scan depends on may be changed by a lifecycle manager as long as the node is unconfigured; a node that
starts itself keeps them for good, so that nobody on the domain chooses a path.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from debris_scanner.core.optional import MissingLibrary
from debris_scanner.core.parameters import ParameterError
from debris_scanner.io.mesh_files import MeshFileError
from debris_scanner.io.result_files import OutputError
from debris_scanner.nodes.lifecycle.diagnostics import ACTIVE, OK, Problem
from debris_scanner.nodes.lifecycle.parameters import declare, refuse_unknown
from debris_scanner.nodes.lifecycle.stage import StageNode
from msg_adapters.errors import BagError

UNCONFIGURED, INACTIVE, FINALIZED = 'unconfigured', 'inactive', 'finalized'
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
UNUSABLE = (ParameterError, OutputError, MeshFileError, BagError, MissingLibrary)  # what a node was given


class ManagedNode(LifecycleNodeMixin, StageNode):
    """A stage with a lifecycle; a subclass makes what it needs in ``setup`` and ends it in ``teardown``."""

    def __init__(self, name: str) -> None:
        self.lifecycle = UNCONFIGURED
        self.failure: Exception | None = None  # why the last configuration failed
        StageNode.__init__(self, name)
        self.autostart = bool(
            declare(self, 'autostart', True, 'configure and activate without a lifecycle manager')
        )
        LifecycleNodeMixin.__init__(self)
        self.declare_parameters_of_stage()
        self.add_on_set_parameters_callback(self._refuse_fixed)
        # in rclpy, a transition that is not allowed raises and would end the process
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._permanent = self._entities()

    # An exception in a callback would end the process, and the next one may meet what caused it.

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], Any], *args: Any, **kwargs: Any
    ) -> Any:
        """A timer whose callback may raise."""
        contained = self._contained(callback, 'a task of the node')
        return super().create_timer(timer_period_sec, contained, *args, **kwargs)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        """A subscription whose callback may raise."""
        contained = self._contained(callback, f'a message on {self.resolve_topic_name(topic)}')
        return super().create_subscription(msg_type, topic, contained, *args, **kwargs)

    def _contained(self, callback: Callable[..., Any], lost: str) -> Callable[..., None]:
        @functools.wraps(callback)  # rclpy looks at the arguments
        def contained(*args: Any) -> None:
            with self.faults.contained(lost):
                callback(*args)

        return contained

    def declare_parameters_of_stage(self) -> None:
        """Declare the parameters that :meth:`setup` reads, so that they can be listed and set before it.

        Raises:
            ParameterError: a parameter has an unusable value.
        """

    def setup(self) -> None:
        """Make the stage, its topics and services.

        Raises:
            ParameterError: a parameter has an unusable value.
            OutputError: a folder cannot be written to.
            MeshFileError: the known model cannot be used.
        """

    def teardown(self) -> None:
        """End what :meth:`setup` made, except topics, services and timers, and forget the scan."""

    def start(self) -> None:
        """Configure and activate.

        Raises:
            ParameterError, OutputError, MeshFileError: as :meth:`setup`.
        """
        self.trigger_configure()
        if self.failure is not None:
            raise self.failure
        self.trigger_activate()

    @property
    def active(self) -> bool:
        """Whether messages are processed; in any other state they are ignored."""
        return self.lifecycle == ACTIVE

    # transitions -----------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make everything; messages are ignored until activation."""
        self.failure = None
        try:
            self.setup()
            refuse_unknown(self)
        except UNUSABLE as error:
            self.failure = error
            if not self.autostart:  # else the process ends with the same line
                self.get_logger().error(f'cannot be configured: {" ".join(str(error).split())}')
            self._dismantle()
            return FAILURE
        return self._reached(INACTIVE, super().on_configure(state))

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Process messages."""
        return self._reached(ACTIVE, super().on_activate(state))

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ignore messages; the scan is kept, and services still answer."""
        return self._reached(INACTIVE, super().on_deactivate(state))

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save and forget the scan, and destroy what was made."""
        self.teardown()
        self._dismantle()
        return self._reached(UNCONFIGURED, super().on_cleanup(state))

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process, saving the scan as on SIGTERM."""
        self.finished = True
        return super().on_shutdown(state)

    # StageNode's methods, in the states in which setup has run ----------------------------------------

    def reset(self) -> None:
        """Start a new scan, if there is one."""
        if self.lifecycle in (INACTIVE, ACTIVE):
            self.reset_stage()

    def reset_stage(self) -> None:
        """Start a new scan."""
        super().reset()

    def close(self) -> None:
        """Save the scan."""
        if self.lifecycle in (INACTIVE, ACTIVE):
            self.close_stage()
        super().close()

    def close_stage(self) -> None:
        """Save the scan, before the last report."""

    def _values(self) -> dict[str, Any]:
        values = super()._values() if self.lifecycle in (INACTIVE, ACTIVE) else {}
        return values | {'lifecycle': self.lifecycle}

    def _problem(self) -> Problem | None:
        return super()._problem() if self.lifecycle == ACTIVE else (OK, self.lifecycle)

    def _refuse_fixed(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse a change of what a configured node depends on."""
        if self.lifecycle != UNCONFIGURED:
            for name in sorted({p.name for p in parameters} & self.fixed_once_configured):
                why = f'{name} is fixed while the node is {self.lifecycle}: clean up, set it, configure again'
                return SetParametersResult(successful=False, reason=why)
        return SetParametersResult(successful=True)

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return self._change_state(request, response)
        except RuntimeError as error:
            self.get_logger().warning(f'no transition {request.transition.id} from {self.lifecycle}: {error}')
            response.success = False
            return response

    def _reached(self, lifecycle: str, outcome: TransitionCallbackReturn) -> TransitionCallbackReturn:
        if outcome == SUCCESS:
            self.lifecycle = lifecycle
        return outcome

    def _entities(self) -> set[Any]:
        kinds = (
            self.publishers, self.subscriptions, self.clients, self.services, self.timers, self.guards,
        )  # fmt: skip
        return {entity for kind in kinds for entity in kind}

    def _dismantle(self) -> None:
        """Destroy the topics, services, timers and guard conditions that :meth:`setup` made."""
        if (settings := getattr(self, 'settings', None)) is not None:
            settings.detach()
        self.counting_subscriptions.clear()
        self.diagnostics.forget_subscribers()
        for kind, destroy in (
            (self.timers, self.destroy_timer),
            (self.guards, self.destroy_guard_condition),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.publishers, self.destroy_publisher),
        ):
            for entity in [e for e in kind if e not in self._permanent]:
                destroy(entity)
