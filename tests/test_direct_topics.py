"""Topics between the nodes of one process, over real middleware for everybody else."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Thread
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64

from dyknow_common.ros import (
    LATCHED_HISTORY,
    STREAM,
    DirectPublisher,
    DirectSubscription,
    DyKnowNode,
    NodeExecutor,
    only_from,
)
from dyknow_common.ros.below_rclpy import direct_topics
from system import LIMIT, Client, private_environment

TOPIC = '/numbers'
SENDER, RECEIVER = 'sender', 'receiver'


class Received:
    """The messages that a direct subscription has received."""

    def __init__(
        self,
        bench: Bench,
        topic: str = TOPIC,
        quality_of_service: QoSProfile = STREAM,
        owner: str = SENDER,
        into: list[Any] | None = None,
    ) -> None:
        self.messages: list[Any] = [] if into is None else into
        self.numbers: list[int] = []
        self.subscription = DirectSubscription(
            bench.receiver, Int64, topic, self._receive, quality_of_service, only_from(f'/{owner}')
        )

    @property
    def values(self) -> list[int]:
        return [each.data for each in self.messages]

    def _receive(self, message: Any, info: Any) -> None:
        self.messages.append(message)
        self.numbers.append(info['publication_sequence_number'])


class Bench:
    """Two nodes of this process, each with a thread, and a client of another participant."""

    def __init__(self) -> None:
        environment = private_environment()
        self.client = Client(environment)
        rclpy.init(args=[], domain_id=int(environment['ROS_DOMAIN_ID']))
        self.sender, self.receiver = DyKnowNode(SENDER), DyKnowNode(RECEIVER)
        self.executors: list[NodeExecutor] = []
        self._threads = [Thread(target=self._spin, args=(each,)) for each in self.nodes]
        for node in self.nodes:
            self.executors.append(NodeExecutor())
            self.executors[-1].add_node(node)
        for thread in self._threads:
            thread.start()

    @property
    def nodes(self) -> tuple[DyKnowNode, DyKnowNode]:
        return self.sender, self.receiver

    def close(self) -> None:
        rclpy.shutdown()
        for thread in self._threads:
            thread.join(LIMIT)
        for executor, node in zip(self.executors, self.nodes, strict=True):
            executor.shutdown()
            node.destroy_node()
        self.client.close()

    def publisher(self, topic: str = TOPIC, quality_of_service: QoSProfile = STREAM) -> Any:
        return DirectPublisher(self.sender, Int64, topic, quality_of_service)

    def outsider(self, quality_of_service: QoSProfile = STREAM, topic: str = TOPIC) -> list[int]:
        values: list[int] = []
        self.client.node.create_subscription(
            Int64, topic, lambda message: values.append(message.data), quality_of_service
        )
        return values

    def wait_for(self, condition: Callable[[], bool], what: str = 'the messages') -> None:
        self.client.spin_until(condition, what)

    def do(self, work: Callable[[], Any]) -> Any:
        """Return the result of a function that the thread of the receiver executes."""
        task = self.executors[1].create_task(work)
        self.wait_for(task.done, 'the receiver')
        return task.result()

    @contextmanager
    def held(self, node: int, work: Callable[[], object] = lambda: None) -> Iterator[None]:
        """A callback of a node executes a function, and then ends with the block."""
        is_held = True

        def hold() -> None:
            work()
            while is_held:
                time.sleep(0.01)

        self.executors[node].create_task(hold)
        self.executors[node].wake()
        try:
            yield
        finally:
            is_held = False

    def _spin(self, node: DyKnowNode) -> None:
        self.executors[self.nodes.index(node)].spin()


@pytest.fixture
def bench() -> Iterator[Bench]:
    running = Bench()
    yield running
    running.close()


def test_the_object_itself_is_received_and_the_middleware_has_no_part(bench: Bench) -> None:
    received, publisher = Received(bench), bench.publisher()
    messages = [Int64(data=number) for number in range(100)]
    for message in messages:
        publisher.publish(message)
    bench.wait_for(lambda: len(received.messages) == 100)
    assert all(map(lambda sent, got: sent is got, messages, received.messages))
    assert received.numbers == list(range(1, 101))
    assert not publisher.is_for_others


def test_messages_of_several_topics_keep_their_order(bench: Bench) -> None:
    got: list[Any] = []
    Received(bench, '/a', into=got)
    Received(bench, '/b', into=got)
    publishers = bench.publisher('/a'), bench.publisher('/b')
    chance = random.Random(1)  # noqa: S311 - to be repeated
    for number in range(500):
        chance.choice(publishers).publish(Int64(data=number))
    bench.wait_for(lambda: len(got) == 500)
    assert [each.data for each in got] == list(range(500))


def test_a_subscriber_of_another_process_receives_what_follows_and_the_own_one_no_copy(
    bench: Bench,
) -> None:
    received, publisher = Received(bench), bench.publisher()
    publisher.publish(Int64(data=0))
    outside = bench.outsider()
    bench.wait_for(lambda: bool(publisher.is_for_others), 'the other subscriber')
    for number in range(1, 50):
        publisher.publish(Int64(data=number))
    bench.wait_for(lambda: outside == list(range(1, 50)))
    bench.wait_for(lambda: len(received.values) >= 50)
    assert received.values == list(range(50))
    assert received.numbers == list(range(1, 51))


def test_copies_are_dropped_after_the_end_of_the_publisher(bench: Bench) -> None:
    received, publisher = Received(bench), bench.publisher()
    bench.outsider()
    bench.wait_for(lambda: bool(publisher.is_for_others), 'the other subscriber')
    for number in range(20):
        publisher.publish(Int64(data=number))
    publisher.destroy()
    again = bench.publisher('/end')
    end = Received(bench, '/end')
    again.publish(Int64(data=0))
    bench.wait_for(lambda: bool(end.messages) and len(received.values) >= 20)
    bench.client.spin_until(lambda: True, 'callbacks')
    assert received.values == list(range(20))


def test_a_copy_whose_publisher_has_ended_is_not_reported_as_lost(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('dyknow_common.ros.guards.UNKNOWN_LIMIT_NS', 0)
    reasons: list[str] = []
    bench.receiver.reject = lambda _, reason: reasons.append(reason)  # type: ignore[method-assign]
    received = Received(bench, quality_of_service=LATCHED_HISTORY)
    with bench.held(1):
        outside = bench.outsider(LATCHED_HISTORY)
        publisher = bench.publisher(quality_of_service=LATCHED_HISTORY)
        bench.wait_for(lambda: publisher.get_subscription_count() == 2, 'the other subscriber')
        publisher.publish(Int64(data=1))
        bench.wait_for(lambda: outside == [1])
        publisher.destroy()
        far = bench.client.node.create_publisher(Int64, TOPIC, LATCHED_HISTORY)
        far.publish(Int64(data=2))
        bench.wait_for(lambda: far.get_subscription_count() == 2, 'the subscribers')
    bench.wait_for(lambda: any('/test_client' in each for each in reasons), 'the refusal')
    assert received.values == [1]
    assert [each for each in reasons if '/test_client' not in each] == []


def test_a_latched_topic_is_published_for_those_that_subscribe_later(bench: Bench) -> None:
    received = Received(bench, quality_of_service=LATCHED_HISTORY)
    publisher = bench.publisher(quality_of_service=LATCHED_HISTORY)
    for number in range(10):
        publisher.publish(Int64(data=number))
    outside = bench.outsider(LATCHED_HISTORY)
    bench.wait_for(lambda: outside == list(range(10)))
    assert received.values == list(range(10))


def test_the_middleware_gets_what_is_received_directly_at_the_end_of_the_callback(
    bench: Bench,
) -> None:
    received = Received(bench, quality_of_service=LATCHED_HISTORY)
    publisher = bench.publisher(quality_of_service=LATCHED_HISTORY)
    outside = bench.outsider(LATCHED_HISTORY)

    def publish() -> None:
        for number in range(10):
            publisher.publish(Int64(data=number))

    with bench.held(0, publish):
        bench.wait_for(lambda: received.values == list(range(10)))
        assert outside == []
    bench.wait_for(lambda: outside == list(range(10)))


def test_the_middleware_gets_what_waits_before_a_message_that_must_not_wait(bench: Bench) -> None:
    """Otherwise, another process receives a state before the violation that it shows."""
    Received(bench, quality_of_service=LATCHED_HISTORY)
    latched, other = bench.publisher(quality_of_service=LATCHED_HISTORY), bench.publisher('/other')
    outside = bench.outsider(LATCHED_HISTORY), bench.outsider(topic='/other')
    bench.wait_for(lambda: other.get_subscription_count() == 1, 'the other subscriber')

    def publish() -> None:
        latched.publish(Int64(data=1))
        other.publish(Int64(data=2))

    with bench.held(0, publish):
        bench.wait_for(lambda: outside == ([1], [2]))


def test_a_publisher_that_ends_within_its_callback_loses_no_message(bench: Bench) -> None:
    Received(bench, quality_of_service=LATCHED_HISTORY)
    publisher = bench.publisher(quality_of_service=LATCHED_HISTORY)
    bench.outsider(LATCHED_HISTORY)
    bench.wait_for(lambda: publisher.get_subscription_count() == 2, 'the other subscriber')
    # The middleware need not deliver what a subscriber has not acknowledged when they end.
    passed_on: list[int] = []

    def publish() -> None:
        inner = publisher._publisher
        with mock.patch.object(inner, 'publish', lambda message: passed_on.append(message.data)):
            for number in range(10):
                publisher.publish(Int64(data=number))
            publisher.destroy()

    bench.executors[0].create_task(publish)
    bench.wait_for(lambda: passed_on == list(range(10)))


def test_a_message_that_the_middleware_refuses_is_counted(bench: Bench) -> None:
    received = Received(bench, quality_of_service=LATCHED_HISTORY)
    reasons: list[str] = []
    bench.sender.reject = lambda _, reason: reasons.append(reason)  # type: ignore[method-assign]
    publisher = DirectPublisher(
        bench.sender, Int64, TOPIC, LATCHED_HISTORY, lambda _: Int64(data='?')
    )
    publisher.publish(Int64(data=1))
    bench.wait_for(lambda: bool(reasons), 'the refusal')
    assert reasons[0].startswith('it cannot be published: ')
    assert received.values == [1]


def test_a_publisher_of_another_process_is_received_too(bench: Bench) -> None:
    far = bench.client.node.create_publisher(Int64, TOPIC, STREAM)
    near = bench.publisher()
    received = Received(bench, owner='test_client')
    bench.wait_for(lambda: far.get_subscription_count() == 1, 'the subscriber')
    near.publish(Int64(data=-1))  # It is refused, as it is of another node.
    far.publish(Int64(data=1))
    bench.wait_for(lambda: received.values == [1])
    assert not near.is_for_others


def test_messages_that_do_not_fit_are_counted_and_the_next_number_shows_it(bench: Bench) -> None:
    received = Received(bench, quality_of_service=QoSProfile(depth=3))
    publisher = bench.publisher(quality_of_service=QoSProfile(depth=3))
    reasons: list[str] = []
    bench.receiver.reject = lambda _, reason: reasons.append(reason)  # type: ignore[method-assign]
    with bench.held(1):
        time.sleep(0.2)
        for number in range(5):
            publisher.publish(Int64(data=number))
    bench.wait_for(lambda: len(received.messages) == 3)
    publisher.publish(Int64(data=5))
    bench.wait_for(lambda: len(received.messages) == 4)
    assert received.values == [0, 1, 2, 5]
    assert received.numbers == [1, 2, 3, 6]
    assert reasons == ['2 more than 3 were waiting']


def test_a_subscription_misses_nothing_while_another_one_of_its_topic_ends() -> None:
    """A violation was neither received directly, nor from the middleware, where it was a copy."""
    directory, key = direct_topics._Directory(), (mock.Mock(), TOPIC)
    stays: Any = SimpleNamespace(key=key)
    others: Any = [SimpleNamespace(key=key) for _ in range(30_000)]
    directory.add(stays)

    def come_and_go() -> None:
        for each in others:
            directory.add(each)
            directory.remove(each)

    changes = Thread(target=come_and_go)
    changes.start()
    while changes.is_alive():
        assert stays in directory.of(key)
    changes.join()
    assert directory.of(key) == (stays,)
    directory.remove(stays)
    assert directory.of(key) == ()


@pytest.mark.parametrize('seed', range(3))
def test_each_subscription_receives_what_is_published_while_it_exists(
    bench: Bench, seed: int
) -> None:
    """As a list of all messages says, with subscribers of any process coming and going."""
    chance, publisher = random.Random(seed), bench.publisher()  # noqa: S311 - to be repeated
    published: list[int] = []
    known: list[tuple[Received, int]] = []
    ended: list[tuple[Received, int, int]] = []
    outside: list[tuple[Node, Any]] = []
    for _ in range(300):
        action = chance.random()
        if action < 0.7:
            publisher.publish(Int64(data=len(published)))
            published.append(len(published))
        elif action < 0.85:
            known.append((bench.do(lambda: Received(bench)), len(published)))
        elif action < 0.95 and known:
            received, begin = known.pop(chance.randrange(len(known)))
            bench.do(received.subscription.destroy)
            ended.append((received, begin, len(published)))
        elif len(outside) < 3:
            node = bench.client.node
            outside.append((node, node.create_subscription(Int64, TOPIC, lambda _: None, STREAM)))
        bench.client.executor.spin_once(timeout_sec=0.0)
    for received, begin in known:
        bench.wait_for(lambda: received.values == published[begin:])  # noqa: B023
    for received, begin, end in ended:
        values = received.values
        assert values == published[begin : begin + len(values)]
        assert len(values) <= end - begin
