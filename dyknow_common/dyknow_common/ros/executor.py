"""An executor that costs a node little for each message."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.task import Task
from rclpy.waitable import NumberOfEntities

Take = Callable[[Any], Any]
"""Takes what has come for an entity: a coroutine function that runs its callback, or None."""

PASSES: Final = 2
"""A coroutine may give one that was resumed before it in the same pass what that one waits for."""


# What `NodeExecutor` uses of rclpy's executor beside what is documented.
_STATE: Final = ('_tasks', '_tasks_lock', '_guard', '_sigint_gc', '_is_shutdown')
_METHODS: Final = tuple(
    f'_take_{kind}'
    for kind in ('timer', 'subscription', 'guard_condition', 'client', 'service', 'waitable')
)


def node_executor() -> SingleThreadedExecutor:
    """The executor of a node: `NodeExecutor`, unless this rclpy is not one that it fits."""
    plain = SingleThreadedExecutor()
    if not fits(plain):
        return plain
    plain.shutdown()
    return NodeExecutor()


def fits(executor: SingleThreadedExecutor) -> bool:
    """Whether an executor of rclpy is inside as those that `NodeExecutor` is made of."""
    return all(hasattr(executor, name) for name in (*_STATE, *_METHODS))


class NodeExecutor(SingleThreadedExecutor):
    """Runs callbacks and coroutines as `SingleThreadedExecutor` does, in the thread that spins.

    rclpy's gathers the entities of a node and makes a wait set of them before each wait, and waits
    twice for each callback: its cost for a message grows with all that the node has. Here the wait
    set is made when entities come or go. (rclpy's `EventsExecutor` runs no coroutine as a service,
    and resumes coroutines without a pause, whatever they wait for.)
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._watch: _Watch | None = None

    def wake(self) -> None:
        """Learns that the entities of a node are others now."""
        self._watch = None
        super().wake()

    def spin(self) -> None:
        """Runs callbacks until the context is shut down."""
        self._resume()
        while self._context.ok() and not self._is_shutdown:
            if self._watch is None:
                self._watch = self._gather()
            for entity, take in self._watch.wait():
                self._execute(entity, take)
            self._resume()

    def _resume(self) -> None:
        """Lets the coroutines go on whose futures are done, until none comes to its end."""
        idle = 0
        while self._tasks and idle < PASSES:
            idle = 0 if self._resume_each() else idle + 1

    def _resume_each(self) -> bool:
        """Whether any has come to its end."""
        with self._tasks_lock:
            tasks = list(self._tasks)
        for task, _, _ in reversed(tasks):
            task()
            if task.done():
                task.result()  # What it raised is raised here.
        ended = [each for each in tasks if each[0].done() or each[0].cancelled()]
        if any(entity for _, entity, _ in ended):
            self._watch = None  # It may have kept others of its group from being served.
        with self._tasks_lock:
            self._tasks = [each for each in self._tasks if each not in ended]
        return bool(ended)

    def _execute(self, entity: Any, take: Take) -> None:
        """Runs the callback of an entity as far as it goes without waiting."""
        group = entity.callback_group
        if not group.beginning_execution(entity):
            return  # A coroutine of its group has begun meanwhile, and is not at its end.
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
        """Makes the wait set of all that may be served now."""
        nodes = self.get_nodes()

        def able(kind: str) -> list[Any]:
            entities = (each for node in nodes for each in getattr(node, kind))
            return [each for each in entities if each.callback_group.can_execute(each)]

        return _Watch(
            (
                _Kind('timer', able('timers'), self._take_timer),
                _Kind('subscription', able('subscriptions'), self._take_subscription),
                _Kind('guard_condition', able('guards'), self._take_guard_condition),
                _Kind('client', able('clients'), self._take_client),
                _Kind('service', able('services'), self._take_service),
            ),
            _Kind('waitable', able('waitables'), self._take_waitable),
            (self._guard, self._sigint_gc),
            self._context,
        )

    def _take_timer(self, tmr: Any) -> Any:
        try:
            with tmr.handle:
                # The wait set calls some ready that were cancelled.
                return super()._take_timer(tmr) if tmr.handle.is_timer_ready() else None
        except InvalidHandle:
            return None

    def _take_waitable(self, waitable: Any) -> Any:
        try:
            return super()._take_waitable(waitable)
        except InvalidHandle:
            return None  # A callback before it has destroyed it.


async def _run(entity: Any, take: Take) -> None:
    try:
        callback = take(entity)
        if callback is not None:
            await callback()
    finally:
        entity.callback_group.ending_execution(entity)


class _Kind(NamedTuple):
    """Entities of one kind, and how to take what has come for one."""

    name: str
    entities: Sequence[Any]
    take: Take


class _Watch:
    """Waits for entities; it serves until one of them is destroyed.

    Args:
        kinds: in the order in which those that are ready at once are served, after waitables.
        waitables: those that consist of several entities of the middleware.
        guards: end the wait, and are not served.
    """

    def __init__(
        self, kinds: Sequence[_Kind], waitables: _Kind, guards: Iterable[Any], context: Context
    ) -> None:
        counts = {kind.name: len(kind.entities) for kind in kinds}
        self._waitables = waitables
        self._context = context
        self._served = [
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
        """The entities for which something has come."""
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
        for kind, entities, take in self._served:
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
