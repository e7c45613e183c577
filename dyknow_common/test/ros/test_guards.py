"""Guards of subscriptions, with a node and a ROS graph that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_common.errors import DyKnowError
from dyknow_common.ros import guards
from dyknow_common.ros.below_rclpy.senders import GID
from dyknow_common.ros.guards import MessageGuard, NodeEndError, only_from, only_owner

TOPIC = '/engine/streams'
OWN, OTHER, NEW = b'1' * 16, b'2' * 16, b'3' * 16
NAMES = {OWN: 'engine', OTHER: 'other'}
ENDS = {666: NodeEndError('the end'), 667: BrokenPipeError()}


class Graph:
    """A node that knows the publishers of all topics, and counts what it rejects."""

    def __init__(self) -> None:
        self.names = dict(NAMES)
        self.rejected: list[str] = []
        self.timers: list[Any] = []
        self.subscriptions: list[Any] = []

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        return [
            SimpleNamespace(endpoint_gid=list(gid), node_name=name, node_namespace='/')
            for gid, name in self.names.items()
        ]

    def get_logger(self) -> Any:
        return None

    def create_timer(self, _period: float, callback: Any, **_: Any) -> Any:
        self.timers.append(callback)
        return callback

    def destroy_timer(self, timer: Any) -> None:
        self.timers.remove(timer)

    def reject(self, topic: str, reason: str) -> None:
        assert topic == TOPIC
        self.rejected.append(reason)


class Reader:
    """A guarded callback; messages are numbers, and 13 is not understood."""

    def __init__(self, refusal: Any = only_owner) -> None:
        self.node = Graph()
        self.taken: list[int] = []
        self.guard = MessageGuard(self.node, TOPIC, self._read, refusal)  # type: ignore[arg-type]
        self.node.subscriptions = [SimpleNamespace(callback=self.guard)]

    def _read(self, number: int) -> None:
        if number == 13:
            raise ValueError('13 is not a number')
        if number in ENDS:
            raise ENDS[number]
        self.taken.append(number)

    def send(self, gid: bytes, *numbers: int) -> None:
        for number in numbers:
            self.guard(number, {GID: gid})


def test_messages_of_the_owner_of_a_topic() -> None:
    reader = Reader()
    reader.send(OWN, 1)
    reader.send(OTHER, 2)
    reader.send(OWN, 13, 3)
    assert reader.taken == [1, 3]
    assert reader.node.rejected == ['it was sent by /other, not by /engine', '13 is not a number']


def test_messages_of_a_known_node() -> None:
    reader = Reader(only_from('/other'))
    reader.send(OWN, 1)
    reader.send(OTHER, 2)
    assert reader.taken == [2]


@pytest.mark.parametrize('info', [{}, {GID: OTHER}])
def test_without_a_refusal_or_an_identifier(info: Any) -> None:
    reader = Reader(only_owner if not info else None)
    for number in (1, 13, 2):
        reader.guard(number, info)
    assert reader.taken == [1, 2]
    assert reader.node.rejected == ['13 is not a number']


def test_a_sender_whose_name_comes_later() -> None:
    """Its messages keep their order, and delay no others."""
    reader = Reader()
    reader.send(NEW, 1, 2)
    reader.send(OWN, 3)
    assert reader.taken == [3]
    reader.node.names[NEW] = 'engine'
    reader.send(NEW, 4)
    assert reader.taken == [3, 1, 2, 4]
    assert not reader.node.timers


def test_a_sender_whose_name_comes_between_two_looks() -> None:
    """The message that waits is looked at before the one that has come."""
    reader = Reader()
    looks = iter([None, None, 'engine', 'engine', 'engine'])
    graph = reader.node.get_publishers_info_by_topic

    def look(topic: str) -> list[Any]:
        if name := next(looks):
            reader.node.names[NEW] = name
        return graph(topic)

    reader.node.get_publishers_info_by_topic = look  # type: ignore[method-assign]
    reader.send(NEW, 1, 2, 3)
    assert reader.taken == [1, 2, 3]


def test_a_sender_that_stays_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = Reader()
    reader.node.names[NEW] = '_NODE_NAME_UNKNOWN_'
    reader.send(NEW, 1, 2)
    (retry,) = reader.node.timers
    retry()
    assert not reader.node.rejected
    now = guards.time.monotonic_ns() + guards.UNKNOWN_LIMIT_NS
    monkeypatch.setattr(guards.time, 'monotonic_ns', lambda: now)
    retry()
    assert reader.node.rejected == ['the node that has sent it is not known'] * 2
    assert not reader.taken
    assert not reader.node.timers


def test_messages_that_wait_for_a_destroyed_subscription_are_forgotten() -> None:
    """The publisher of the result of a formula may be gone before the graph tells its node."""
    reader = Reader()
    reader.send(NEW, 1)
    (retry,) = reader.node.timers
    reader.node.subscriptions.clear()
    reader.node.names[NEW] = 'engine'
    retry()
    assert (reader.taken, reader.node.rejected, reader.node.timers) == ([], [], [])


def test_messages_that_wait_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guards, 'MAX_HELD', 2)
    reader = Reader()
    reader.send(NEW, 1, 2, 3)
    assert reader.node.rejected == ['more than 2 wait for the names of their senders']


@pytest.mark.parametrize('number', ENDS)
def test_an_error_that_ends_the_node(number: int) -> None:
    with pytest.raises(type(ENDS[number])):
        Reader().send(OWN, number)


def test_reasons_quote_little_of_a_message() -> None:
    reader = Reader()

    def refuse(_number: int) -> None:
        raise DyKnowError(f"'{'x' * 10**6}' is no name")

    guard = MessageGuard(reader.node, TOPIC, refuse)  # type: ignore[arg-type]
    guard(1, {})
    guard.reject(ValueError(f"invalid literal for int() with base 10: '{'7' * 10**6}'"))
    assert all(len(each) < 200 for each in reader.node.rejected)
