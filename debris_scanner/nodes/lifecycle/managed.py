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
topics, services and timers exist from configure to cleanup.
"""

import functools
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from debris_scanner.core.optional import MissingLibrary
from debris_scanner.core.parameters import ParameterError
from debris_scanner.io.result_files import OutputError
from debris_scanner.nodes.lifecycle.diagnostics import ACTIVE, OK, Problem
from debris_scanner.nodes.lifecycle.parameters import declare, refuse_unknown
from debris_scanner.nodes.lifecycle.stage import StageNode

UNCONFIGURED, INACTIVE, FINALIZED = 'unconfigured', 'inactive', 'finalized'
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


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
        contained = self._contained(callback, f'a message on {topic}')
        return super().create_subscription(msg_type, topic, contained, *args, **kwargs)

    def _contained(self, callback: Callable[..., Any], lost: str) -> Callable[..., None]:
        @functools.wraps(callback)  # rclpy looks at the arguments
        def contained(*args: Any) -> None:
            with self.faults.contained(lost):
                callback(*args)

        return contained

    def setup(self) -> None:
        """Make the stage, its topics and services.

        Raises:
            ParameterError: a parameter has an unusable value.
            OutputError: a folder cannot be written to.
        """

    def teardown(self) -> None:
        """End what :meth:`setup` made, except topics, services and timers, and forget the scan."""

    def start(self) -> None:
        """Configure and activate.

        Raises:
            ParameterError, OutputError: as :meth:`setup`.
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
        except (ParameterError, OutputError, MissingLibrary) as error:
            self.failure = error
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
