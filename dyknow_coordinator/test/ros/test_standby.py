"""The standby of a formula group: when it is made, given up and taken."""

from __future__ import annotations

import asyncio
from itertools import count
from typing import Any
from unittest.mock import AsyncMock, MagicMock, call

import pytest

from dyknow_common import SECOND_NS, ExitCode, StreamConstraints
from dyknow_coordinator import CoordinationError, KnownStream, KnownStreams
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.source_session import StandbySources
from dyknow_coordinator.ros.evaluation.standby import Standby
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_stream_processing import ViolationKind


def source(topic: str, feature: str = 'F') -> FeatureSource:
    name = f'{feature}_{topic}'.lower()
    text = f'stream {name} = select x as {feature} from "/{topic}"'
    return FeatureSource(feature, name, text)


A, B, C, G = source('a'), source('b'), source('c'), source('g', 'G')
GROUP = 7


class World:
    """A standby, and what it calls; time passes between two looks only."""

    def __init__(self) -> None:
        self.now = 0
        self.published = {'/a', '/b', '/c', '/g'}
        context = self.context = MagicMock()
        context.wall_time.side_effect = lambda: self.now
        context.wall_time_s.side_effect = lambda: self.now / SECOND_NS
        self.waiting: set[str] = set()
        context.names = (f'states_{number}' for number in count(2))
        context.state_topic = lambda name: f'/{name}'
        context.clients.keep_states = AsyncMock()
        context.clients.create_stream = AsyncMock(
            side_effect=lambda name, *_: self._report(name) or (f'/{name}', f'/{name}/violations')
        )
        self._made: list[str] = []
        self._report()
        self._looks: list[Any] = []
        context.node.spawn = self._looks.append
        # All waits are over, as when a node ends: each look is then the last one.
        context.node.deadlines.after.return_value.done.return_value = True
        self.sources = StandbySources(lambda: context.streams.known, Candidates(()))
        self.standby = Standby(context, self.sources, GROUP, StreamConstraints(), self._new_stream)

    def _report(self, *names: str) -> None:
        """Report the streams with some names, besides those before; some topics are streams."""
        self._made += names
        streams = [
            KnownStream(name, topic=f'/{name}', waits_for='samples' * (name in self.waiting))
            for name in (*self._made, 'a', 'b', 'c', 'g')
        ]
        self.context.streams.known = KnownStreams(streams, self.published.__contains__)

    def wait(self, *names: str) -> None:
        """Report that just the streams with some names have no samples."""
        self.waiting = set(names)
        self._report()

    def _new_stream(self, name: str) -> StateStream:
        return StateStream(self.context, name, MagicMock(), MagicMock())

    def follow(
        self,
        *in_use: FeatureSource,
        seconds: int = 0,
        found: tuple[FeatureSource, ...] = (A, B, C, G),
    ) -> None:
        self.now += seconds * SECOND_NS
        self.standby.follow(in_use, Candidates(found))
        while self._looks:
            asyncio.run(self._looks.pop()())

    @property
    def kept(self) -> list[str]:
        """The topics that the reasoning engine was told to keep."""
        return [each.args[1] for each in self.context.clients.keep_states.mock_calls]

    def taken(self) -> tuple[FeatureSource, ...] | None:
        taken = self.standby.take()
        return None if taken is None else taken.chosen


def violation(stream_name: str, kind: ViolationKind = ViolationKind.MAX_DELAY) -> Any:
    return MagicMock(stream_name=stream_name, constraint=kind)


@pytest.fixture
def world() -> World:
    return World()


def test_the_next_source_of_each_feature_is_on_standby(world: World) -> None:
    world.follow(A, G)
    assert world.context.clients.keep_states.mock_calls == [call(GROUP, '/states_2')]
    assert world.taken() == (B, G)
    assert world.taken() is None


def test_without_another_source_there_is_none(world: World) -> None:
    world.follow(G)
    world.published -= {'/b', '/c'}
    world.follow(A, G)
    assert world.kept == []
    assert world.taken() is None


def test_the_same_standby_stays(world: World) -> None:
    world.follow(A, G)
    world.follow(A, G, seconds=3)
    assert world.kept == ['/states_2']
    world.published.discard('/b')
    assert world.taken() is None
    world.follow(A, G, seconds=3)
    assert world.kept == ['/states_2', '/states_3']
    assert world.taken() == (C, G)


def test_a_better_source_does_not_replace_a_standby(world: World) -> None:
    """Its states are kept since a while."""
    world.sources.exclude([B], 0)
    world.follow(A, G)
    world.follow(A, G, seconds=12)
    assert world.kept == ['/states_2']
    assert world.taken() == (C, G)


def test_a_standby_without_states_is_not_taken(world: World) -> None:
    world.follow(A, G)
    world.wait('states_2')
    assert world.taken() is None
    world.wait()
    assert world.taken() == (B, G)


def test_a_source_that_has_samples_replaces_a_standby_that_has_none(world: World) -> None:
    """It was not known when the standby was made."""
    world.published.discard('/b')
    world.follow(A, G)
    world.published.add('/b')
    world.wait('c', 'states_2')
    world.follow(A, G, seconds=3)
    assert world.kept == ['/states_2', '/states_3']
    assert world.taken() == (B, G)


def test_the_standby_changes_at_once_with_the_sources_in_use(world: World) -> None:
    world.follow(A, G)
    world.follow(B, G)
    assert world.kept == ['/states_2', '/states_3']
    assert world.taken() == (A, G)


@pytest.mark.parametrize('kind', [ViolationKind.MAX_GAP, ViolationKind.LOST])
def test_a_violation_of_the_standby_excludes_its_source(world: World, kind: ViolationKind) -> None:
    world.follow(A, G)
    # It is reported in the stream in use, too, if both are made of its topic.
    world.standby.note_violation(MagicMock(), violation('/b', kind))
    assert world.taken() is None
    world.follow(A, G, seconds=3)
    assert world.taken() == (C, G)
    world.follow(A, G, seconds=10)
    assert world.taken() == (B, G)


def test_a_source_that_was_recreated_is_not_used_at_once(world: World) -> None:
    """The stream manager may not know yet which stream has its name."""
    world.published.discard('/c')
    world.follow(A, G)
    world.standby.note_violation(MagicMock(), violation('/a', ViolationKind.SOURCE))
    assert world.taken() == (B, G)
    world.follow(B, G, seconds=3)
    assert world.taken() is None
    world.follow(B, G, seconds=10)
    assert world.taken() == (A, G)


def test_a_source_that_both_use_spoils_both(world: World) -> None:
    world.follow(A, G)
    world.standby.note_violation(MagicMock(), violation('/g'))
    assert world.taken() is None
    world.follow(A, G, seconds=3)
    assert world.taken() is None


def test_a_clock_that_was_set_back_ends_the_standby(world: World) -> None:
    world.follow(A, G)
    world.standby.note_violation(MagicMock(), violation(''))
    assert world.taken() is None
    world.follow(A, G, seconds=3)
    assert world.taken() == (B, G)


def test_no_failed_source_is_taken(world: World) -> None:
    world.follow(A, G)
    world.sources.exclude([G], 0)
    assert world.taken() is None


def test_a_standby_that_cannot_be_made_is_tried_later(world: World) -> None:
    error = CoordinationError('no engine', ExitCode.UNAVAILABLE)
    made = world.context.clients.create_stream.side_effect
    world.context.clients.create_stream.side_effect = error
    world.follow(A, G)
    assert world.taken() is None
    assert world.kept == []
    world.context.clients.create_stream.side_effect = made
    world.follow(A, G, seconds=3)
    assert world.taken() == (C, G)


def test_the_reasoning_engine_keeps_nothing_in_vain(world: World) -> None:
    world.published.discard('/c')
    world.follow(A, G)
    world.standby.note_violation(MagicMock(), violation('/b'))
    world.follow(A, G, seconds=3)
    assert world.kept == ['/states_2', '']


def test_a_stream_that_carries_nothing_any_more_is_not_kept(world: World) -> None:
    """Otherwise, nobody could destroy it."""
    world.follow(A, G)
    world.context.cleanup.destroy_stream.assert_not_called()
    world.follow(A, G, found=(A, G))
    world.context.cleanup.destroy_stream.assert_called_once_with('states_2')
    assert world.kept == ['/states_2', '']


def test_a_group_that_ends_while_its_standby_is_made(world: World) -> None:
    async def create(*_: object) -> tuple[str, str]:
        world.standby.end()
        return '/states_2', '/states_2/violations'

    world.context.clients.create_stream = create
    world.follow(A, G)
    world.context.cleanup.destroy_stream.assert_called_once_with('states_2')
    assert world.kept == []
