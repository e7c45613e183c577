"""Pauses of a process; times in milliseconds."""

from __future__ import annotations

from threading import current_thread
from time import monotonic_ns, sleep
from unittest.mock import Mock

import pytest

from dyknow_stream_processing.ros.topics import process_pauses, watermark_topics
from dyknow_stream_processing.ros.topics.node_topics import _in_time
from dyknow_stream_processing.ros.topics.process_pauses import PauseWait, ProcessPauses
from dyknow_stream_processing.ros.topics.topic_feed import ReceivedMessage
from dyknow_stream_processing.ros.topics.watermark_topics import WatermarkSubscriptions

MS = 1_000_000


@pytest.fixture
def pauses() -> ProcessPauses:
    found = ProcessPauses(0)
    for time in range(0, 500, 50):
        found.note_sign_of_life(time * MS)
    return found


def test_a_process_that_runs_has_no_pause(pauses: ProcessPauses) -> None:
    assert pauses.unsettled_for(600 * MS) is None
    assert pauses.delay(300 * MS, 600 * MS) == 0


def test_messages_of_before_may_come_some_time_after_a_pause(pauses: ProcessPauses) -> None:
    assert pauses.unsettled_for(5450 * MS) == 5000 * MS
    pauses.note_sign_of_life(5500 * MS)
    assert pauses.unsettled_for(5650 * MS) == 5200 * MS
    pauses.note_sign_of_life(5690 * MS)
    assert pauses.unsettled_for(5700 * MS) is None


def test_the_thread_may_notice_a_pause_first(pauses: ProcessPauses) -> None:
    pauses.note_sign_of_life(5450 * MS)
    assert pauses.unsettled_for(5451 * MS) == 5001 * MS


def test_of_two_pauses_the_first_one_counts(pauses: ProcessPauses) -> None:
    assert pauses.unsettled_for(1450 * MS) == 1000 * MS
    assert pauses.unsettled_for(2450 * MS) == 2000 * MS


@pytest.mark.parametrize(
    ('pause', 'run', 'longest'), [(5000, 10_000, 260), (230, 120, 1120), (230, 30, None)]
)
def test_messages_wait_for_a_bounded_time_if_one_pause_follows_another(
    monkeypatch: pytest.MonkeyPatch, pause: int, run: int, longest: int | None
) -> None:
    """They waited until 250 ms passed without a pause: on a busy computer for ever."""
    pauses, own = ProcessPauses(0), current_thread()

    def now() -> int:
        # The thread of the pauses of this process goes on.
        return time * MS if current_thread() is own else monotonic_ns()

    monkeypatch.setattr(process_pauses, 'time', Mock(monotonic_ns=now, sleep=sleep))
    monkeypatch.setattr(pauses, 'start', Mock())
    monkeypatch.setattr(process_pauses, 'PAUSES', pauses)
    wait = PauseWait(Mock(), Mock(), Mock(), Mock())
    waits: list[int] = []
    since = time = 0
    while time < 15_000:
        resumed = time = time + pause
        since = since or resumed
        while time < resumed + run:
            time += 10
            pauses.note_sign_of_life(time * MS)
            if wait.goes_on(time * MS):
                assert wait.length(time * MS) >= pause * MS
                continue
            wait.end()
            assert wait.length(time * MS) == 0
            if since:
                assert time - resumed > 50
                waits.append(time - since)
            since = 0
    assert max(waits, default=None) == longest


@pytest.mark.parametrize('is_caught_up', [False, True])
def test_watermarks_count_once_the_messages_before_them_are_processed(
    monkeypatch: pytest.MonkeyPatch, *, is_caught_up: bool
) -> None:
    """While one pause followed another, streams that needed a watermark had no sample."""
    monkeypatch.setattr(watermark_topics, 'is_pause_recent', lambda: True)
    topic = Mock(topic='/streams/a', is_stream=True)
    subscriptions = WatermarkSubscriptions(Mock(), Mock(), lambda: [topic], lambda _: is_caught_up)
    subscriptions._on_message('/streams', Mock(streams=[Mock(stream_name='a')]))
    assert topic.vouch.called == is_caught_up


def test_messages_that_are_received_after_a_pause_may_have_waited(pauses: ProcessPauses) -> None:
    assert pauses.waiting_since(10 * MS, 500 * MS) is None
    pauses.note_sign_of_life(5450 * MS)
    for time in range(5500, 9000, 50):
        pauses.note_sign_of_life(time * MS)
    received = {449: None, 450: 8550, 5460: 8550, 5699: 8550, 5700: None, 8000: None}
    for at, waiting in received.items():
        since = pauses.waiting_since((9000 - at) * MS, 9000 * MS)
        assert since == (None if waiting is None else waiting * MS), at


def test_a_request_has_waited_no_longer_than_the_pause(pauses: ProcessPauses) -> None:
    pauses.note_sign_of_life(5450 * MS)
    assert pauses.delay(3000 * MS, 5500 * MS) == 3000 * MS
    assert pauses.delay(9000 * MS, 5500 * MS) == 5000 * MS
    assert pauses.delay(-9000 * MS, 5500 * MS) == 0
    for time in range(5500, 17000, 50):
        pauses.note_sign_of_life(time * MS)
    assert pauses.delay(3000 * MS, 17000 * MS) == 0


@pytest.mark.parametrize(
    ('stamp', 'sent_at', 'receipt'),
    [(1000, 1800, 1800), (1000, 0, 1000), (None, 1800, 1800), (1000, 9000, 5000), (200, 300, 500)],
)
def test_no_message_was_received_before_it_was_sent(
    stamp: int | None, sent_at: int, receipt: int
) -> None:
    """The clock of a sender that was stopped between stamp and sending seemed to be ahead."""
    feed = Mock(listeners=(Mock(valid_time=lambda _: stamp),))
    message = ReceivedMessage(feed, None, None, receipt_time=5000, sent_at=sent_at)
    assert [each.receipt_time for each in _in_time([message], 500)] == [receipt]
