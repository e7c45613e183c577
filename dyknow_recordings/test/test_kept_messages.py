"""Messages that publishers kept for late subscribers, for streams of a recording made later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from recorded import ListedSamples, RecordedSample, at, sample

from dyknow_common import NO_CONSTRAINTS, SECOND_NS
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.recording import in_order, rows_of
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


def kept_samples(*messages: RecordedSample) -> tuple[list[int], list[str]]:
    """Return the valid times, in seconds, and faults of /mode, whose publishers keep messages."""
    recording = ListedSamples(messages)
    contents = {name: replace(each, is_kept=True) for name, each in recording.contents.items()}
    streams = RecordedStreams(contents, ())
    samples: list[Sample] = []
    violations: list[Violation] = []
    text = 'select x from "/mode"'
    streams.create('mode', text, NO_CONSTRAINTS, samples.append, violations.append)
    for row in in_order(recording.columns({'/mode': ('x',)})):
        streams.push(row)
    streams.dataflow.advance(at(100))
    times = [round((each.valid_time - at(0)) / SECOND_NS) for each in samples]
    return times, [each.constraint for each in violations]


def without_stamp(each: RecordedSample) -> RecordedSample:
    return each._replace(is_sent=True)


@pytest.mark.parametrize('form', [without_stamp, RecordedSample._make], ids=['sent', 'stamped'])
def test_what_was_kept_for_the_recorder_is_never_late(
    form: Callable[[RecordedSample], RecordedSample],
) -> None:
    """A second publisher is found soon after the first one; the value that it keeps is older."""
    first, second = sample('/mode', 3, delay=17, x=1), sample('/mode', 5, delay=15.5, x=2)
    later, late = sample('/mode', 21, delay=0.05, x=3), sample('/mode', 30, delay=2, x=4)
    messages = [form(each) for each in (first, second, later, late)]
    assert kept_samples(*messages) == ([3, 5, 21], ['max_delay'])
    older = form(sample('/mode', 1, delay=19.6, x=0))
    assert kept_samples(messages[0], older) == ([3], [])


def test_a_kept_message_of_a_publisher_that_is_found_later_is_never_late() -> None:
    former = without_stamp(sample('/mode', 3, delay=17, x=1))
    other = without_stamp(sample('/mode', 5, delay=30, x=2))
    assert kept_samples(former, other) == ([3, 5], [])


def test_an_old_stamp_long_after_the_first_message_is_late() -> None:
    """The time at which a stamped message was sent is unknown."""
    messages = sample('/mode', 3, delay=17, x=1), sample('/mode', 5, delay=30, x=2)
    assert kept_samples(*messages) == ([3], ['max_delay'])
