"""What a stream manager tells of the streams that engines make, without nodes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing.management.registry import StreamRegistry
from dyknow_stream_processing.management.streams import CreatedStream
from dyknow_stream_processing.reporting.stream_report import (
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.ros.management.placement import Placement

LEVEL = 'select data as level from "/tank/level"'
HALF = 'select level as half from level'
TOPICS = {name: f'/dyknow/streams/{name}' for name in ('level', 'half')}
KNOWN, FOREIGN = 7, 8
"""Ids of the stream on the topic of `level`."""


def identities(registry: StreamRegistry, source: SourceReport) -> dict[str, int]:
    """What a manager tells if the engine of `half` reports that it reads a source."""
    half = StreamReport(
        'half',
        StreamState.FLOWING,
        specification=HALF,
        topic=TOPICS['half'],
        stream_id=1,
        sources=(source,),
    )
    engines: Any = SimpleNamespace(reports=lambda engine: {'half': half} if engine == 'two' else {})
    node: Any = SimpleNamespace(create_timer=lambda *_, **__: None, wall_clock=None)
    nothing: Any = lambda *_: None  # noqa: E731
    placement = Placement(node, registry, engines, nothing, nothing, nothing)
    placement._compared['two', 'half'] = HALF, NO_CONSTRAINTS
    return dict(placement.identities())


@pytest.fixture
def registry() -> StreamRegistry:
    found = StreamRegistry()
    found.add(CreatedStream('level', LEVEL, NO_CONSTRAINTS))
    found.place('level', 'one', TOPICS['level'], {}, stream_id=KNOWN)
    found.add(CreatedStream('half', HALF, NO_CONSTRAINTS))
    found.place('half', 'two', TOPICS['half'], {'level': TOPICS['level']}, stream_id=1)
    return found


def test_a_stream_that_reads_the_known_one_is_certain(registry: StreamRegistry) -> None:
    source = SourceReport(TOPICS['level'], stream_id=KNOWN)
    assert identities(registry, source)[TOPICS['half']] == 1


@pytest.mark.parametrize('change', ['none', 'withdrawn', 'forgotten'])
def test_a_stream_that_reads_another_one_is_not_certain(
    registry: StreamRegistry, change: str
) -> None:
    if change == 'withdrawn':
        registry.withdraw('level', 'another stream has its topic', failed=True)
    elif change == 'forgotten':
        registry.forget('level')
    source = SourceReport(TOPICS['level'], stream_id=FOREIGN)
    assert identities(registry, source)[TOPICS['half']] == 0


@pytest.mark.parametrize('topic', ['/remote/carrier/level', '/tank/level'])
def test_streams_of_other_systems_are_not_known(registry: StreamRegistry, topic: str) -> None:
    assert identities(registry, SourceReport(topic, stream_id=FOREIGN))[TOPICS['half']] == 1
