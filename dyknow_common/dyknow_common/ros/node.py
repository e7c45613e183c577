"""The base of all nodes: parameters, services that always respond, deadlines, status."""

from __future__ import annotations

import re
import traceback
from collections.abc import Awaitable, Callable, Mapping
from difflib import get_close_matches
from inspect import isawaitable
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node

from dyknow_common.errors import DyKnowError, one_line, shortened
from dyknow_common.ros.callback_groups import PrunedCallbackGroup, PrunedExclusiveCallbackGroup
from dyknow_common.ros.deadlines import Deadlines
from dyknow_common.ros.guards import NodeEndError, create_guarded_subscription, only_owner
from dyknow_common.ros.heartbeat import NodeHeartbeat
from dyknow_common.ros.liveliness import Heartbeats
from dyknow_common.ros.qos import (
    LATCHED,
    NO_PUBLISHER_EVENTS,
    SERVICE,
    STATUS,
)
from dyknow_common.ros.throttle import Throttle
from dyknow_common.ros.time_messages import error_to_message
from dyknow_common.ros.topic_names import RCLError

RUNNING = 'running'
"""The message in the status of a node that has everything it needs."""

STARTED_AT = 'born'
"""The key of the time of start in a node's status; it distinguishes a restarted node."""

DROPPED = 'dropped messages'
"""The key of the number of messages that could not be used, in a node's status."""

NODE_TYPE = 'type'
"""The key of the kind of node in its status, such as `stream_processing_engine`."""

HANG_LIMIT_S = 20.0
"""The default of the time without progress after which a node hangs."""

REPORT_PERIOD_S = 1.0
"""The time between two reports of dropped messages."""

_FILES = 'files'
_QUALITY_OF_SERVICE = 'qos_overrides.'
_USE_SIM_TIME = 'use_sim_time'


def started_at(status: DiagnosticStatus) -> int:
    """Return when a node started, in nanoseconds, given its status; -1 if that does not tell."""
    values = (each.value for each in status.values if each.key == STARTED_AT)
    return next((int(each) for each in values if each.isdecimal()), -1)


class DyKnowNode(Node):
    """A node whose services always respond, and whose heartbeats show that it is alive."""

    def __init__(self, name: str) -> None:
        # The base class creates entities of the default group.
        self._exclusive = PrunedExclusiveCallbackGroup()
        super().__init__(name)
        self.reentrant = PrunedCallbackGroup()
        # Runs also while simulated time stands still.
        self.wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.deadlines = Deadlines(self, self.wall_clock)
        self.heartbeats = Heartbeats.of(self)
        # Simulated time may start again with each run.
        self.started_at = int(Clock(clock_type=ClockType.SYSTEM_TIME).now().nanoseconds)
        """The time of start by the system clock, in nanoseconds; unique among nodes of one name."""
        self.heartbeat = NodeHeartbeat(self, self.started_at, self._publish_status)
        self.hang_limit_s = self.changing_parameter(
            'hang_limit',
            HANG_LIMIT_S,
            'Seconds without progress after which the process of the node ends; 0: never.',
            (0.0, 3600.0),
        )
        self._status: Any = None
        self._last_status: Any = None
        self._loaded: dict[str, int] = {}
        self._dropped = 0
        self._reported_drops = 0
        self._last_drop = ('', '')
        self.add_on_set_parameters_callback(self._check_parameters)
        self.set_status(RUNNING)

    @property
    def default_callback_group(self) -> CallbackGroup:
        """The mutually exclusive callback group of entities that are created without one."""
        return self._exclusive

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """Create a publisher, by default without event handlers, which cost time at messages."""
        return super().create_publisher(
            *arguments, **{'event_callbacks': NO_PUBLISHER_EVENTS, **options}
        )

    create_subscription = create_guarded_subscription

    def create_report_subscription(
        self, report_type: Any, topic: str, callback: Any, **options: Any
    ) -> Any:
        """Subscribe to a latched report that the node of its topic alone may send."""
        return self.create_subscription(
            report_type, topic, callback, LATCHED, refusal=only_owner, **options
        )

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Any:
        """Create a service; arguments as for rclpy.

        A request that the callback cannot handle, such as one of rclpy's own services for
        parameters with an unknown type, is counted, and gets the response as it is.
        """

        async def guarded(request: Any, response: Any) -> Any:
            try:
                outcome = callback(request, response)
                return await outcome if isawaitable(outcome) else outcome
            except Exception as error:  # noqa: BLE001 - it would end the executor
                self.reject(srv_name, str(error))
                return response

        return super().create_service(srv_type, srv_name, guarded, **options)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], Any], *arguments: Any, **options: Any
    ) -> Any:
        """Create a timer; the exceptions of its callback are logged, and it continues."""
        throttle = Throttle(REPORT_PERIOD_S)

        async def guarded() -> None:
            try:
                outcome = callback()
                if isawaitable(outcome):
                    await outcome
            except NodeEndError:
                raise
            except Exception as error:  # noqa: BLE001 - it would end the executor
                if throttle.is_due():
                    self.log_fault(getattr(callback, '__qualname__', repr(callback)), error)

        return super().create_timer(timer_period_sec, guarded, *arguments, **options)

    def reject(self, topic: str, reason: str) -> None:
        """Count a message that was dropped; the log and the status report it soon."""
        self._dropped += 1
        self._last_drop = topic, reason
        if self._dropped == self._reported_drops + 1:
            due = self.deadlines.after(REPORT_PERIOD_S)
            due.add_done_callback(lambda _: self._report_drops())

    def announce(self) -> None:
        """Start the heartbeats and publish the status, as all services exist and may be called.

        Raises:
            DyKnowError: ALREADY_EXISTS, if another node of this name is running.
        """
        self.heartbeat.start()
        self._report_unknown_parameters()
        self.log_ready()
        self._status = self.create_publisher(DiagnosticStatus, '~/_status', STATUS)
        self._publish_status()

    def log_ready(self) -> None:
        """Log that it is ready, and what it has loaded; a node that needs others does so later."""
        self.get_logger().info(f'ready: {loaded_text(self._loaded)}' if self._loaded else 'ready')

    def _report_unknown_parameters(self) -> None:
        """Warn of given parameters that the node does not have; ROS ignores them silently."""
        known = [*self._parameters]
        for name in sorted({*self._parameter_overrides} - {*known}):
            if not name.startswith(_QUALITY_OF_SERVICE):
                similar = get_close_matches(name, known, n=1)
                hint = f"did you mean '{similar[0]}'?" if similar else 'it has no effect'
                self.get_logger().warning(f"unknown parameter '{name}'; {hint}")

    def set_loaded(self, counts: Mapping[str, int]) -> None:
        """Set the numbers of things that the node has loaded, in plural: `streams`, and `files`.

        They are logged when the node is ready, and are values of each later status.
        """
        self._loaded = dict(counts)

    def set_status(
        self, message: str, values: Mapping[str, str] | None = None, *, level: bytes | None = None
    ) -> None:
        """Set the status, which is published on `~/_status` with the type and the time of start."""
        identity = {NODE_TYPE: snake_case(type(self).__name__), STARTED_AT: str(self.started_at)}
        loaded = {name: str(number) for name, number in self._loaded.items()}
        self._last_status = DiagnosticStatus(
            level=DiagnosticStatus.OK if level is None else level,
            name=self.get_fully_qualified_name(),
            message=message,
            values=[
                KeyValue(key=key, value=value)
                # A value's name, such as a stream's, must not hide the identity.
                for key, value in {**identity, **loaded, **(values or {}), **identity}.items()
            ],
        )
        self._publish_status()

    @property
    def latest_status(self) -> Any:
        """The last DiagnosticStatus that was set."""
        return self._last_status

    def _publish_status(self) -> None:
        if self._status is not None:
            status, drops = self._last_status, self._dropped
            if drops:
                last = ': '.join(map(shortened, self._last_drop))
                values = {DROPPED: str(drops), 'last dropped': last}
                held = [each for each in status.values if each.key not in values]
                added = [KeyValue(key=key, value=value) for key, value in values.items()]
                status.values = [*held, *added]
            self._status.publish(status)

    def _report_drops(self) -> None:
        new, self._reported_drops = self._dropped - self._reported_drops, self._dropped
        counted = 'a message was' if new == 1 else f'{new} messages were'
        topic, reason = self._last_drop
        self.get_logger().warning(f'{counted} dropped, the last one of {topic}: {reason}')
        self._publish_status()

    def _check_parameters(self, parameters: list[Any]) -> SetParametersResult:
        """Refuse changes that a running node cannot take over."""
        for each in parameters:
            if each.name == _USE_SIM_TIME and each.value != self.get_parameter(each.name).value:
                reason = f'{_USE_SIM_TIME} is read at the start, as all streams depend on the clock'
                return SetParametersResult(
                    successful=False, reason=f'{reason}; restart the node to change it'
                )
        return SetParametersResult(successful=True)

    def changing_parameter(
        self,
        name: str,
        default: Any,
        description: str,
        bounds: tuple[float, float] | None = None,
    ) -> Callable[[], Any]:
        """Declare a parameter that may change at any time; return what reads its present value."""
        self.parameter(name, default, description, bounds, is_fixed=False)
        return lambda: self.get_parameter(name).value

    def parameter(
        self,
        name: str,
        default: Any,
        description: str,
        bounds: tuple[float, float] | None = None,
        *,
        is_fixed: bool = True,
    ) -> Any:
        """Declare a parameter, and return its value; a fixed one is read at the start alone."""
        descriptor = ParameterDescriptor(
            description=description,
            read_only=is_fixed,
            additional_constraints='It is read when the node starts.' if is_fixed else '',
        )
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
        """Create a service under a private name that follows from its type.

        Args:
            service_type: `StreamCreateFromSpec` is served as `~/stream_create_from_spec`.
            handler: fills in the response, given request and response; its exceptions become the
                exit status of the response.
        """
        name = service_type.__name__

        async def respond(request: Any, response: Any) -> Any:
            try:
                outcome = handler(request, response)
                if isawaitable(outcome):
                    await outcome
            except (DyKnowError, RCLError) as error:
                if isinstance(error, RCLError):
                    error = DyKnowError(f'the middleware refuses it: {one_line(error)}')
                response.exit_status = error_to_message(error)
                self.get_logger().info(f'{name}: {error}')
            except Exception as error:  # noqa: BLE001 - the caller must get a response
                response.exit_status = error_to_message(error)
                self.log_fault(name, error)
            return response

        self.create_service(
            service_type,
            f'~/{snake_case(name)}',
            respond,
            qos_profile=SERVICE,
            callback_group=self.reentrant,
        )

    def spawn(self, work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
        """Run a coroutine beside the callbacks; its exceptions are logged."""

        async def guarded() -> None:
            try:
                await work(*arguments)
            except Exception as error:  # noqa: BLE001 - it would end the executor
                self.log_fault(work.__qualname__, error)

        if self.executor is None:
            if not self.context.ok():
                return  # The node has stopped, and its unfinished coroutines clean up.
            raise RuntimeError('a node can spawn work only while an executor runs it')
        self.executor.create_task(guarded)

    def log_fault(self, where: str, error: Exception) -> None:
        """Log an unexpected error, with its traceback."""
        if not self.context.ok():
            return  # The node stops: nothing can be published or requested any more.
        text = ''.join(traceback.format_exception(error))
        self.get_logger().error(f'fault in {where}:\n{text}')

    def request_sent_at(self) -> int | None:
        """Return when the request was sent whose service is called and has not awaited yet.

        It is in nanoseconds of the client's system clock; `None` if it is unknown.
        """
        return getattr(self.executor, 'request_sent_at', None)

    def now(self) -> int:
        """Return the time of the node's ROS clock in nanoseconds."""
        return int(self.get_clock().now().nanoseconds)


def is_time_simulated(node: Node) -> bool:
    """Return True if a node takes its time from the topic /clock."""
    # The clock of a node is a ROSClock, but rclpy declares it as a Clock.
    return bool(cast('ROSClock', node.get_clock()).ros_time_is_active)


def loaded_text(counts: Mapping[str, int]) -> str:
    """Return what was loaded in words, `2 streams from 1 file` for {'streams': 2, 'files': 1}."""

    def counted(kind: str) -> str:
        return f'{counts[kind]} {kind.removesuffix("s") if counts[kind] == 1 else kind}'

    things = ', '.join(counted(kind) for kind in counts if kind != _FILES)
    return f'{things} from {counted(_FILES)}' if _FILES in counts else things


def snake_case(name: str) -> str:
    """Return a name in snake case, `stream_get_topic` for `StreamGetTopic`."""
    words = re.sub(r'(.)([A-Z][a-z]+)', r'\1_\2', name)
    return re.sub(r'([a-z0-9])([A-Z])', r'\1_\2', words).lower()
