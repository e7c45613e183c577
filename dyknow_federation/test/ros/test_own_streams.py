"""The own streams that peers have asked for: made, and made anew when they are gone."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock, MagicMock

import pytest
from dyknow_interfaces.msg import StreamStatus, StreamStatusArray

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_federation.messages import StreamFault
from dyknow_federation.ros import own_streams
from dyknow_federation.ros.own_streams import GONE_NS, NAME, RETRY_NS, OwnStreams


class Host:
    """The own streams of a host whose stream manager is played by the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0
        self.spawned: list[Any] = []
        self.manager: Any = SimpleNamespace(call=AsyncMock(), alive=True, on_lost=[])
        self.topics, self.peer = MagicMock(), MagicMock(sent={'Level': {}})
        monkeypatch.setattr(own_streams, 'RemoteNode', lambda *_, **__: self.manager)
        monkeypatch.setattr(own_streams, 'NodeTopics', MagicMock(of=lambda _: self.topics))
        clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))
        node = MagicMock(wall_clock=clock, now=lambda: self.now)
        node.spawn = lambda function, *given: self.spawned.append(function(*given))
        node.parameter = lambda *_: 'stream_manager'
        self.streams = OwnStreams(node, self.peer, lambda: None)
        self.streams.offers = {'Level': MagicMock(specification='select')}
        self.report: Callable[[Any], None] = node.create_report_subscription.call_args.args[2]

    def wait(self, time: int, *streams: str, engines: tuple[str, ...] = ('/engine',)) -> None:
        """Report streams, and wait."""
        statuses = [StreamStatus(name=each) for each in streams]
        self.report(StreamStatusArray(engines=engines, streams=statuses))
        for _ in range(0, time, SECOND_NS // 2):
            self.reconcile()
            self.now += SECOND_NS // 2

    def reconcile(self) -> None:
        self.streams.reconcile()
        while self.spawned:
            asyncio.run(self.spawned.pop())

    @property
    def creations(self) -> int:
        return self.manager.call.await_count


def test_a_stream_that_is_gone_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host(monkeypatch)
    host.wait(GONE_NS * 2, NAME + 'Level')
    assert host.creations == 1
    assert host.streams.made == {'Level'}
    host.wait(SECOND_NS)
    assert (host.creations, host.streams.made) == (1, frozenset())
    host.peer.violate.assert_not_called()
    host.wait(GONE_NS)
    assert host.creations == 2
    name, fault, _ = host.peer.violate.call_args.args
    assert name == 'Level'
    assert isinstance(fault, StreamFault)
    assert fault.constraint == 'lost'
    host.wait(2 * GONE_NS, NAME + 'Level')
    assert (host.creations, host.streams.made) == (2, {'Level'})


def test_what_a_manager_does_not_know_yet_is_not_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A restarted one learns from its engines what they make."""
    host = Host(monkeypatch)
    host.wait(SECOND_NS, NAME + 'Level')
    host.manager.alive = False
    for forget in host.manager.on_lost:
        forget()
    assert not host.streams.made
    host.streams.reconcile()
    host.now += 2 * GONE_NS
    host.streams.reconcile()
    host.manager.alive = True
    host.wait(2 * GONE_NS, engines=())
    host.wait(GONE_NS // 2)
    host.wait(GONE_NS, NAME + 'Level')
    assert host.creations == 1
    assert host.streams.made == {'Level'}
    host.peer.violate.assert_not_called()


@pytest.mark.parametrize(('left', 'calls'), [('select', 1), ('another', 3), ('', 3)])
def test_a_stream_that_an_earlier_run_has_left(
    monkeypatch: pytest.MonkeyPatch, left: str, calls: int
) -> None:
    """A formula of that run may be made from it, for as long as its end is not noticed."""
    host = Host(monkeypatch)
    taken = DyKnowError('there is a stream already', ExitCode.ALREADY_EXISTS)
    created = SimpleNamespace(stream_topic='/new')
    host.manager.call.side_effect = [taken, None, created]
    status = StreamStatus(name=NAME + 'Level', specification=left, topic='/left')
    host.report(StreamStatusArray(engines=['/engine'], streams=[status]))
    host.reconcile()
    assert host.creations == calls
    assert host.topics.listen.call_args.args[0] == ('/left' if calls == 1 else '/new')
    assert host.streams.made == {'Level'}


def test_what_cannot_be_made_is_tried_again_later(monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host(monkeypatch)
    host.manager.call.side_effect = DyKnowError('it is refused')
    for _ in range(3):
        host.reconcile()
    assert host.creations == 1
    assert host.streams.faults == ("stream 'Level' cannot be shared: it is refused",)
    host.manager.call.side_effect = None
    host.now += RETRY_NS
    host.reconcile()
    assert host.creations == 2
    assert not host.streams.faults
