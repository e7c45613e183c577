"""Messages that publishers kept for late subscribers, for streams of a recording made later."""

from __future__ import annotations

from dataclasses import replace

import pytest
from recorded import ListedSamples, at, sample

from dyknow_common import NO_CONSTRAINTS, SECOND_NS
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.recording import rows_of
from dyknow_stream_processing import Sample, Violation


@pytest.mark.parametrize('is_kept', [True, False])
@pytest.mark.parametrize('is_batch', [True, False])
def test_a_later_stream_has_the_message_that_was_kept(is_kept: bool, is_batch: bool) -> None:  # noqa: FBT001
    before = ListedSamples([sample('/mode', 1, x=1, y=10), sample('/speed', 2, v=1)])
    after = ListedSamples([sample('/speed', 9, v=2), sample('/mode', 10, x=2, y=20)])
    contents = {
        topic: replace(each, is_kept=is_kept and topic == '/mode')
        for topic, each in before.contents.items()
    }
    streams = RecordedStreams(contents, ())
    samples: list[Sample] = []
    violations: list[Violation] = []

    def create(name: str, text: str) -> None:
        streams.create(name, text, NO_CONSTRAINTS, samples.append, violations.append)

    create('former', 'select x from "/mode"')
    fields = {'/mode': ('x', 'y'), '/speed': ('v',)}
    batch = list(before.columns(fields))
    if is_batch:
        columns = {each.topic: [each] for each in batch}
        assert streams.step_many(columns, at(2)) is not None
        assert streams.step_many({}, at(2) + SECOND_NS) is not None
    else:
        for row in rows_of(batch):
            streams.push(row)
    samples.clear()
    create('later', 'select y as kept from "/mode" with max_delay = 100 ms')
    assert not samples, 'It comes with the next message.'
    batch = list(after.columns(fields))
    columns = {each.topic: [each] for each in batch}
    assert (streams.step_many(columns, at(10)) is None) is is_kept
    for row in rows_of(batch) if is_kept else ():
        streams.push(row)
    streams.dataflow.advance(at(11))
    found = [(each.valid_time, each.fields) for each in samples if 'kept' in each.fields]
    kept = [(at(1), {'kept': 10})] if is_kept else []
    assert found == [*kept, (at(10), {'kept': 20})]
    assert not violations
