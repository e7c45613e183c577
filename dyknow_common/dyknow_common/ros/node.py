"""What every node shares: parameters, guarded services, waits that end, status, shutdown."""

from __future__ import annotations

import re
import traceback
from collections.abc import Awaitable, Callable, Mapping
from inspect import isawaitable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.ros.deadlines import Deadlines
from dyknow_common.ros.qos import NO_PUBLISHER_EVENTS, SERVICE, STATUS

RUNNING = 'running'
"""What a node says on its status topic when it has all that it needs."""

BORN = 'born'
"""The key in a node's status that tells it from one that had its name before."""


class DyKnowNode(Node):
    """A node whose services answer whatever happens, and of which others know whether it lives."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.reentrant = ReentrantCallbackGroup()
        # For what must go on while simulated time stands still.
        self.wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.deadlines = Deadlines(self, self.wall_clock)
        # Simulated time may begin anew with each run.
        self.born = int(Clock(clock_type=ClockType.SYSTEM_TIME).now().nanoseconds)
        """When it was started, by the system clock, nanoseconds: tells it from its predecessors."""
        self._status: Any = None
        self._last_status: Any = None
        self.set_status(RUNNING)

    def announce(self) -> None:
        """Begins to tell its status, once all its services are there: then others call them."""
        self._status = self.create_publisher(
            DiagnosticStatus, '~/status', STATUS, event_callbacks=NO_PUBLISHER_EVENTS
        )
        self._status.publish(self._last_status)

    def set_status(
        self, message: str, values: Mapping[str, str] | None = None, *, level: bytes | None = None
    ) -> None:
        """Says on `~/status` how the node is, and when it was born."""
        self._last_status = DiagnosticStatus(
            level=DiagnosticStatus.OK if level is None else level,
            name=self.get_fully_qualified_name(),
            message=message,
            values=[
                KeyValue(key=key, value=value)
                for key, value in {BORN: str(self.born), **(values or {})}.items()
            ],
        )
        if self._status is not None:
            self._status.publish(self._last_status)

    def parameter(
        self,
        name: str,
        default: Any,
        description: str,
        bounds: tuple[float, float] | None = None,
    ) -> Any:
        """Declares a parameter that is read at the start, and returns its value."""
        descriptor = ParameterDescriptor(description=description, read_only=True)
        if bounds is not None and isinstance(default, float):
            low, high = bounds
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif bounds is not None:
            low, high = (int(bound) for bound in bounds)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        return self.declare_parameter(name, default, descriptor).value

    def serve(
        self, service_type: Any, handler: Callable[[Any, Any], Awaitable[None] | None]
    ) -> None:
        """Offers a service under the private name that its type gives it.

        Args:
            service_type: `StreamCreateFromSpec` is served as `~/stream_create_from_spec`.
            handler: fills in the response, given request and response. What it raises is told to
                the caller in the exit status.
        """

        async def answer(request: Any, response: Any) -> Any:
            try:
                outcome = handler(request, response)
                if isawaitable(outcome):
                    await outcome
            except Exception as error:  # noqa: BLE001 - the caller must get an answer
                fill_exit_status(response.exit_status, error)
                self._log_fault(service_type, error)
            return response

        self.create_service(
            service_type,
            f'~/{snake_case(service_type.__name__)}',
            answer,
            qos_profile=SERVICE,
            callback_group=self.reentrant,
        )

    def spawn(self, work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
        """Runs a coroutine beside the callbacks; what it raises is logged."""

        async def guarded() -> None:
            try:
                await work(*arguments)
            except Exception as error:  # noqa: BLE001 - it would end the executor
                text = ''.join(traceback.format_exception(error))
                self.get_logger().error(f'fault in {work.__qualname__}:\n{text}')

        if self.executor is None:
            raise RuntimeError('a node spawns work only once it runs')
        self.executor.create_task(guarded)

    def _log_fault(self, service_type: Any, error: Exception) -> None:
        if isinstance(error, DyKnowError):
            self.get_logger().info(f'{service_type.__name__}: {error}')
        else:
            text = ''.join(traceback.format_exception(error))
            self.get_logger().error(f'fault in {service_type.__name__}:\n{text}')

    def now(self) -> int:
        """The time of the node's ROS clock in nanoseconds."""
        return int(self.get_clock().now().nanoseconds)


def fill_exit_status(exit_status: Any, error: Exception) -> None:
    """Tells a caller of an error: the one place where errors become exit statuses."""
    if isinstance(error, DyKnowError):
        exit_status.code, exit_status.message = int(error.code), error.message
    else:
        exit_status.code = int(ExitCode.INTERNAL_ERROR)
        exit_status.message = f'fault in DyKnow: {type(error).__name__}: {error}'


def snake_case(name: str) -> str:
    """`StreamGetTopic` -> `stream_get_topic`."""
    words = re.sub(r'(.)([A-Z][a-z]+)', r'\1_\2', name)
    return re.sub(r'([a-z0-9])([A-Z])', r'\1_\2', words).lower()
