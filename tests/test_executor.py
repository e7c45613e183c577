"""The executor of all nodes, over real middleware."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dyknow_common.ros import NodeExecutor, supports_node_executor
from system import private_environment

PERIOD = 0.01
LIMIT = 20.0


class Bench:
    """A node that spins until a test has what it wants."""

    def __init__(self) -> None:
        self.context = Context()
        self.context.init(domain_id=int(private_environment()['ROS_DOMAIN_ID']))
        self.node = Node('bench', context=self.context)
        self.executor = NodeExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._is_late = False

    def timer(self, callback: Callable[[], Any], group: Any = None) -> Any:
        """A timer that does not come too early for anything."""
        return self.node.create_timer(PERIOD, callback, clock=self.steady, callback_group=group)

    def end(self) -> None:
        """Has `spin` end, with what is being executed now."""
        self.context.shutdown()

    def spin(self) -> None:
        """Runs callbacks until `end`; fails where that does not come."""
        guard = threading.Timer(LIMIT, self._give_up)
        guard.start()
        try:
            self.executor.spin()
        finally:
            guard.cancel()
        assert not self._is_late, f'not within {LIMIT} s'

    def _give_up(self) -> None:
        self._is_late = True
        self.end()

    def close(self) -> None:
        """Leaves the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A node of its own for each test."""
    one = Bench()
    yield one
    one.close()


def test_a_service_that_is_a_coroutine_calls_another_of_its_node(bench: Bench) -> None:
    group = ReentrantCallbackGroup()
    answers: list[Any] = []
    inner = bench.node.create_client(Trigger, 'inner', callback_group=group)
    outer = bench.node.create_client(Trigger, 'outer', callback_group=group)

    async def relay(request: Any, _response: Any) -> Any:
        return await inner.call_async(request)

    def answer(_request: Any, response: Any) -> Any:
        response.message = 'from within'
        return response

    def take(done: Future) -> None:
        answers.append(done.result().message)
        bench.end()

    def ask() -> None:
        if inner.service_is_ready() and outer.service_is_ready():
            timer.cancel()
            outer.call_async(Trigger.Request()).add_done_callback(take)

    bench.node.create_service(Trigger, 'inner', answer, callback_group=group)
    bench.node.create_service(Trigger, 'outer', relay, callback_group=group)
    timer = bench.timer(ask, group)
    bench.spin()
    assert answers == ['from within']


def test_what_is_made_in_a_callback_is_served(bench: Bench) -> None:
    heard: list[str] = []

    def hear(message: Any) -> None:
        heard.append(message.data)
        bench.end()

    def make() -> None:
        timer.cancel()
        bench.node.create_subscription(String, 'words', hear, 10)
        publisher = bench.node.create_publisher(String, 'words', 10)
        bench.timer(lambda: publisher.publish(String(data='hello')))

    timer = bench.timer(make)
    bench.spin()
    assert heard[0] == 'hello'


@pytest.mark.parametrize('end', [Node.destroy_timer, lambda _, timer: timer.cancel()])
def test_a_timer_that_another_callback_has_ended_is_not_served(
    bench: Bench, end: Callable[[Node, Any], Any]
) -> None:
    served: list[int] = []
    timers: list[Any] = []

    def serve(number: int) -> None:
        served.append(number)
        if len(served) == 1:
            end(bench.node, timers[1 - number])
        if len(served) > 2:
            bench.end()

    # Both are ready at once, and the one that is served first ends the other.
    timers += [bench.timer(lambda number=number: serve(number)) for number in range(2)]
    bench.spin()
    assert len(set(served)) == 1


def test_callbacks_that_exclude_each_other_wait_for_a_coroutine(bench: Bench) -> None:
    events: list[str] = []
    gate: Future = Future()

    async def first() -> None:
        timers[0].cancel()
        events.append('begin')
        await gate
        events.append('end')

    def second() -> None:
        events.append('second')
        if 'end' in events:
            bench.end()

    def open_gate() -> None:
        others[0].cancel()
        events.append('open')
        gate.set_result(None)

    timers = [bench.timer(first)]  # It is in the group of all callbacks that name none.
    bench.timer(second)
    others = [bench.node.create_timer(0.2, open_gate, callback_group=ReentrantCallbackGroup())]
    bench.spin()
    assert events[events.index('begin') + 1 :][:3] == ['open', 'end', 'second']


def test_a_coroutine_goes_on_with_what_a_later_one_gives_it(bench: Bench) -> None:
    # Nothing else happens on this node that could have it looked at again.
    futures: list[Future] = [Future() for _ in range(5)]
    passed: list[int] = []

    async def pass_on(number: int) -> None:
        await futures[number]
        passed.append(number)
        if number + 1 < len(futures):
            futures[number + 1].set_result(None)
        else:
            bench.end()

    for number in (3, 1, 4, 0, 2):
        bench.executor.create_task(pass_on, number)
    futures[0].set_result(None)
    bench.spin()
    assert passed == [0, 1, 2, 3, 4]


def test_a_task_of_another_thread_is_run(bench: Bench) -> None:
    thread = threading.Timer(0.1, lambda: bench.executor.create_task(bench.end))
    thread.start()
    bench.spin()
    thread.join()


@pytest.mark.parametrize('is_coroutine', [False, True])
def test_what_a_callback_raises_ends_the_spin(bench: Bench, *, is_coroutine: bool) -> None:
    now: Future = Future()

    async def fail_later() -> None:
        await now
        raise KeyError('later')

    def fail() -> None:
        if not is_coroutine:
            raise KeyError('now')
        bench.executor.create_task(fail_later)
        now.set_result(None)

    bench.timer(fail)
    with pytest.raises(KeyError, match='later' if is_coroutine else 'now'):
        bench.spin()


def test_another_rclpy_runs_nodes_by_its_own_executor(bench: Bench) -> None:
    plain = SingleThreadedExecutor(context=bench.context)
    assert supports_node_executor(plain)
    delattr(plain, '_tasks')
    assert not supports_node_executor(plain)
    bench.end()
