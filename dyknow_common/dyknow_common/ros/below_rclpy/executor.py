"""An executor whose cost for a message does not grow with the number of a node's entities.

rclpy's executor gathers all entities of a node (subscriptions, timers, services, ...) and makes a
wait set of them before each wait, and waits twice for each callback. `NodeExecutor` makes the wait
set only when entities come or go, or when the callbacks of a group become able to run or not:

    wait set: subscription a, service s
    a message on a, a request to s   one wait returns both; both callbacks start
    the callback of s awaits         its coroutine becomes a task; s is of a reentrant group, so
                                     the wait set stays
    the callback of a creates b      rclpy calls `wake`: a new wait set with a, b and s
    the response that s awaits       wakes the wait; then the task is resumed and ends
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any, Final, NamedTuple

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor, await_or_execute
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.task import Task
from rclpy.waitable import NumberOfEntities

from dyknow_common.ros.below_rclpy.senders import gives_identifiers
from dyknow_common.ros.below_rclpy.versions import is_on
from dyknow_common.ros.guards import MessageGuard

Take = Callable[[Any], Any]
"""A function that takes the data of an entity; it returns a coroutine function, or None."""

MAX_IDLE_PASSES: Final = 2
"""A task may complete the future of another one that was resumed before it in the same pass."""


# The undocumented parts of rclpy's executor that `NodeExecutor` uses.
_STATE: Final = ('_tasks', '_tasks_lock', '_guard', '_sigint_gc', '_is_shutdown')
_METHODS: Final = tuple(
    f'_take_{kind}'
    for kind in ('timer', 'subscription', 'guard_condition', 'client', 'service', 'waitable')
)


def node_executor() -> SingleThreadedExecutor:
    """Return a `NodeExecutor`, or rclpy's executor if this version of rclpy does not support it."""
    plain = SingleThreadedExecutor()
    if not supports_node_executor(plain):
        return plain
    plain.shutdown()
    return NodeExecutor()


@cache
def has_senders() -> bool:
    """Return True if nodes know which node has sent a message."""
    plain = SingleThreadedExecutor()
    try:
        return supports_node_executor(plain) and gives_identifiers()
    finally:
        plain.shutdown()


def supports_node_executor(executor: SingleThreadedExecutor) -> bool:
    """Return True if an executor of rclpy has all parts that `NodeExecutor` uses."""
    return is_on() and all(hasattr(executor, name) for name in (*_STATE, *_METHODS))


class NodeExecutor(SingleThreadedExecutor):
    """An executor that runs callbacks and coroutines in the thread that spins.

    rclpy's `EventsExecutor` is no alternative: it cannot run a coroutine as a service, and polls
    coroutines without a pause.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._watch: _Watch | None = None
        self.request_sent_at: int | None = None
        """See `DyKnowNode.request_sent_at`."""

    def wake(self) -> None:
        """Make a new wait set; called by rclpy when the entities of a node change."""
        self._watch = None
        super().wake()

    def spin(self) -> None:
        """Run callbacks until the context is shut down."""
        self._resume()
        while self._context.ok() and not self._is_shutdown:
            if self._watch is None:
                self._watch = self._gather()
            for entity, take in self._watch.wait():
                self._execute(entity, take)
            self._resume()

    def _resume(self) -> None:
        """Resume the tasks whose futures are done, until none of them ends any more."""
        idle_passes = 0
        while self._tasks and idle_passes < MAX_IDLE_PASSES:
            idle_passes = 0 if self._resume_each() else idle_passes + 1

    def _resume_each(self) -> bool:
        """Resume each task once; return True if any has ended."""
        with self._tasks_lock:
            tasks = list(self._tasks)
        for task, _, _ in reversed(tasks):
            task()
            if task.done():
                task.result()  # raises the exception of the task
        ended = [each for each in tasks if each[0].done() or each[0].cancelled()]
        if any(entity for _, entity, _ in ended):
            self._watch = None  # Other entities of its group may run again.
        with self._tasks_lock:
            self._tasks = [each for each in self._tasks if each not in ended]
        return bool(ended)

    def _execute(self, entity: Any, take: Take) -> None:
        """Run the callback of an entity until it ends or awaits."""
        group = entity.callback_group
        if not group.beginning_execution(entity):
            return  # A coroutine of its group has started meanwhile, and has not ended.
        running = _run(entity, take)
        try:
            running.send(None)
        except StopIteration:
            return
        if not group.can_execute(entity):
            self._watch = None
        with self._tasks_lock:
            self._tasks.append((Task(running, executor=self), entity, None))

    def _gather(self) -> _Watch:
        """Make the wait set of all entities whose callbacks may run now."""
        nodes = self.get_nodes()

        def executable(kind: str) -> list[Any]:
            entities = (each for node in nodes for each in getattr(node, kind))
            return [each for each in entities if each.callback_group.can_execute(each)]

        return _Watch(
            (
                _Kind('timer', executable('timers'), self._take_timer),
                _Kind('subscription', executable('subscriptions'), self._take_subscription),
                _Kind('guard_condition', executable('guards'), self._take_guard_condition),
                _Kind('client', executable('clients'), self._take_client),
                _Kind('service', executable('services'), self._take_service),
            ),
            _Kind('waitable', executable('waitables'), self._take_waitable),
            (self._guard, self._sigint_gc),
            self._context,
        )

    def _take_timer(self, tmr: Any) -> Any:
        try:
            with tmr.handle:
                # The wait set also returns timers that were cancelled.
                return super()._take_timer(tmr) if tmr.handle.is_timer_ready() else None
        except InvalidHandle:
            return None

    def _take_subscription(self, sub: Any) -> Any:
        if not (isinstance(sub.callback, MessageGuard) and sub.callback.needs_sender):
            return super()._take_subscription(sub)
        try:
            with sub.handle:
                taken = sub.callback.take(sub)
        except InvalidHandle:
            return None  # Another callback has destroyed it.
        if taken is None:
            return None

        async def execute() -> None:
            sub.callback(*taken)

        return execute

    def _take_service(self, srv: Any) -> Any:
        try:
            with srv.handle:
                request, header = srv.handle.service_take_request(srv.srv_type.Request)
        except InvalidHandle:
            return None
        if header is None:
            return None

        async def execute() -> None:
            self.request_sent_at = header.source_timestamp
            response = await await_or_execute(srv.callback, request, srv.srv_type.Response())
            srv.send_response(response, header)

        return execute

    def _take_waitable(self, waitable: Any) -> Any:
        try:
            return super()._take_waitable(waitable)
        except InvalidHandle:
            return None  # Another callback has destroyed it.


async def _run(entity: Any, take: Take) -> None:
    try:
        callback = take(entity)
        if callback is not None:
            await callback()
    finally:
        entity.callback_group.ending_execution(entity)


class _Kind(NamedTuple):
    """Entities of one kind, and the function that takes the data of one."""

    name: str
    entities: Sequence[Any]
    take: Take


class _Watch:
    """A wait set of entities; it is valid until one of them is destroyed.

    Args:
        kinds: in the order in which entities that are ready at once are returned, after waitables.
        waitables: entities that consist of several entities of the middleware.
        guards: end the wait, and are not returned.
    """

    def __init__(
        self, kinds: Sequence[_Kind], waitables: _Kind, guards: Iterable[Any], context: Context
    ) -> None:
        counts = {kind.name: len(kind.entities) for kind in kinds}
        self._waitables = waitables
        self._context = context
        self._kinds = [
            (kind.name, {each.handle.pointer: each for each in kind.entities}, kind.take)
            for kind in kinds
        ]
        handles = [(kind.name, each.handle) for kind in kinds for each in kind.entities]
        for guard in guards:
            handles.append(('guard_condition', guard.handle))
            counts['guard_condition'] += 1
        self._wait_set = _wait_set(counts, waitables.entities, context)
        self._additions = [
            (getattr(self._wait_set, f'add_{kind}'), handle) for kind, handle in handles
        ]

    def wait(self) -> Iterator[tuple[Any, Take]]:
        """Wait, and yield the entities that are ready."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        for add, handle in self._additions:
            add(handle)
        for waitable in self._waitables.entities:
            waitable.add_to_wait_set(wait_set)
        wait_set.wait(-1)
        if not self._context.ok():
            return
        for waitable in [each for each in self._waitables.entities if each.is_ready(wait_set)]:
            yield waitable, self._waitables.take
        for kind, entities, take in self._kinds:
            for pointer in wait_set.get_ready_entities(kind):
                if pointer in entities:
                    yield entities[pointer], take


def _wait_set(counts: dict[str, int], waitables: Iterable[Any], context: Context) -> Any:
    number = NumberOfEntities(
        counts['subscription'],
        counts['guard_condition'],
        counts['timer'],
        counts['client'],
        counts['service'],
    )
    for waitable in waitables:
        number += waitable.get_num_entities()
    return rclpy_implementation.WaitSet(
        number.num_subscriptions,
        number.num_guard_conditions,
        number.num_timers,
        number.num_clients,
        number.num_services,
        number.num_events,
        context.handle,
    )
