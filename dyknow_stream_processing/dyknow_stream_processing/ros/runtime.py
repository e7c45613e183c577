"""What every node shares: parameters, guarded services, waits that end, status, shutdown."""

from __future__ import annotations

import faulthandler
import os
import re
import sys
import threading
import time
import traceback
from contextlib import suppress
from inspect import isawaitable
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_services_default,
)
from rclpy.task import Future

from dyknow_stream_processing.errors import DyKnowError, ExitCode
from dyknow_stream_processing.ros.executor import node_executor

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from dyknow_stream_processing.ros.guest import Guest

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""The state of something, for those who come later too."""

LATCHED_HISTORY = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Events that those who come a little later must not miss."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Samples: none is lost between two nodes."""

PULSE = 0.05
"""Seconds between two looks for waits that are over."""

SHUTDOWN_LIMIT = 5.0
"""Seconds that a node may take to stop."""

RUNNING = 'running'
"""What a node says on its status topic when it has all that it needs."""

BORN = 'born'
"""The key in a node's status that tells it from one that had its name before."""

LEASE = Duration(seconds=1)
"""A node that has not been heard of for this long is taken for dead."""

STATUS = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=LEASE,
)

VIOLATIONS = QoSProfile(
    depth=LATCHED_HISTORY.depth,
    reliability=LATCHED_HISTORY.reliability,
    durability=LATCHED_HISTORY.durability,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=LEASE,
)
"""Violations of a stream; by the lease those who use the stream learn that its engine is gone."""

# The default depth of 10 drops requests without a word when many come at once.
SERVICE = QoSProfile(
    history=qos_profile_services_default.history,
    reliability=qos_profile_services_default.reliability,
    durability=qos_profile_services_default.durability,
    depth=1000,
)

# Event handlers cost time at each message, and rclpy makes one for every topic by default.
NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


class DyKnowNode(Node):
    """A node whose services answer whatever happens, and of which others know whether it lives."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.reentrant = ReentrantCallbackGroup()
        # For what must go on while simulated time stands still.
        self.wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.deadlines = Deadlines(self)
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


class Deadlines:
    """Ends waits: one timer of the wall clock for all that a node waits for.

    It ticks always: a node without timers was seen to sleep on in its wait set though a signal or a
    request had come, and the tick wakes it.
    """

    def __init__(self, node: DyKnowNode | Guest) -> None:
        self._clock = node.wall_clock
        self._due: dict[Future, tuple[int, DyKnowError | None]] = {}
        self._over = False
        self.timer = node.create_timer(
            PULSE, self._expire, clock=self._clock, callback_group=ReentrantCallbackGroup()
        )

    def fail(self, future: Future, seconds: float, error: DyKnowError) -> None:
        """Gives a future an error after a time, unless it is done before."""
        self._add(future, seconds, error)

    def after(self, seconds: float) -> Future:
        """A future that is done after a time; whoever does not need it any more cancels it."""
        future: Future = Future()
        self._add(future, seconds, None)
        return future

    def _add(self, future: Future, seconds: float, error: DyKnowError | None) -> None:
        self._due[future] = (self._clock.now().nanoseconds + round(seconds * 1e9), error)
        future.add_done_callback(lambda done: self._due.pop(done, None))
        if self._over:
            self._end([future])

    def end_all(self) -> None:
        """Ends all waits before their time, and from now on each at once."""
        self._over = True
        self._end(list(self._due))

    def _expire(self) -> None:
        now = self._clock.now().nanoseconds
        self._end([future for future, (due, _) in list(self._due.items()) if due <= now])

    def _end(self, futures: Sequence[Future]) -> None:
        for future in futures:
            _, error = self._due.get(future, (0, None))
            if future.done():
                continue
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)


def _exit_in_any_case() -> None:
    """Ends the process some time after it was told to stop, even if the node does not come back.

    The middleware may wait for ever for a lock in shared memory that a killed process held.
    """

    def watch() -> None:
        while rclpy.ok():
            time.sleep(PULSE)
        time.sleep(SHUTDOWN_LIMIT)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def _exit_even_if_no_thread_runs() -> None:
    """Ends the process with code 1 some time later, and prints where it hangs.

    The middleware may let no other thread of Python run while it waits.
    """
    with suppress(AttributeError, OSError, RuntimeError, ValueError):  # There is no stderr.
        faulthandler.dump_traceback_later(SHUTDOWN_LIMIT + 1.0, exit=True)


def run(make_node: Callable[[], DyKnowNode], arguments: Sequence[str] | None = None) -> int:
    """Runs a node until SIGINT or SIGTERM; the main function of every executable.

    Returns:
        The exit code: 0 after a clean stop, 1 when the node cannot start.
    """
    rclpy.init(args=None if arguments is None else list(arguments))
    _exit_in_any_case()
    node: DyKnowNode | None = None
    executor = node_executor()
    try:
        node = make_node()
        executor.add_node(node)
        node.announce()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (DyKnowError, ParameterException) as error:
        print(error, file=sys.stderr)  # noqa: T201 - there is no node to log with
        return 1
    except Exception:
        # A stop in the middle of the start leaves half a node: what it then trips over is no fault.
        if rclpy.ok():
            raise
    finally:
        _exit_even_if_no_thread_runs()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
