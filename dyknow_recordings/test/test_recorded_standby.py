"""The standby over recordings: what happens to sources that no stream can be made of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from dyknow_coordinator import Candidates, FeatureSource, KnownStreams, StandbySources
from dyknow_coordinator.grounding.source_session import EXCLUSION_NS
from dyknow_reasoning import StateLine
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.standby import RecordedStandby, RecordedStates


def source(topic: str) -> FeatureSource:
    return FeatureSource('F', topic, f'stream {topic} = select x as F from "/{topic}"')


A, B, C = source('a'), source('b'), source('c')


def test_sources_that_no_stream_can_be_made_of_leave_the_standby_to_others() -> None:
    made: list[tuple[FeatureSource, ...]] = []
    unusable = {B}

    def create(stream: RecordedStates) -> None:
        if not unusable.isdisjoint(stream.chosen):
            raise RecordingError('no unit has this name')
        made.append(stream.chosen)

    streams: Any = SimpleNamespace(
        known=KnownStreams([], lambda _: True), destroy=lambda name: made.remove(name_of[name])
    )
    name_of = {'one': (C,)}
    sources = StandbySources(lambda: streams.known, Candidates((A, B, C)))
    standby = RecordedStandby(sources, streams, create, StateLine(lambda _: None))
    standby.follow('one', (A,), (A,), 0)  # As B stands by in vain, C does.
    assert made == [(C,)]
    assert standby.due == EXCLUSION_NS
    unusable.add(C)
    sources.exclude([C], 1)
    standby.follow('two', (A,), (A,), 1)
    assert made == []
    assert standby.stream is None
