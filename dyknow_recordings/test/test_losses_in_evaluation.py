"""Evaluations over recordings that lack some messages, against those over all messages."""

from __future__ import annotations

from itertools import chain, product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import at, recording, sample
from test_column_states import (
    BATCHES,
    FILES,
    FORMULAS,
    MESSAGES,
    PUBLISHERS,
    STARTS,
    STREAM_FORMULAS,
    Drawn,
    made,
)

from dyknow_common import Verdict
from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import Outcome

pytestmark = pytest.mark.long

PAST_FORMULAS = (
    'once[0 s, 2 s] "/a".v + "/b".v > 5',
    'historically "/a".v + "/b".v < 9',
    '("/a".v + "/b".v < 6) since "/b".v > 2',
    'always ("/a".v > 2 -> previous "/b".v < 3)',
    'count("/b".v > 1, 1 s) + "/a".v < 5',
    'not "/a".v - prev("/b".v) > 1',
)
TRIGGERS = ('"/a".v > 1', '"/b".v > 2 and not (previous "/a".v > 1)')
EPISODES = (
    *STARTS,
    *(EpisodeStart(every=Every.TRIGGER, trigger=each) for each in TRIGGERS),
)


@given(
    st.tuples(MESSAGES, MESSAGES, MESSAGES).map(lambda parts: [*chain(*parts)]),
    st.tuples(st.integers(0, 60) | st.integers(0, 3), st.integers(0, 8)),
    st.sampled_from([None, {'/a'}, {'/b'}, {'/c'}, {'/a', '/c'}]),
    BATCHES,
    st.lists(
        st.sampled_from(FORMULAS + STREAM_FORMULAS + PAST_FORMULAS * 3),
        min_size=1,
        max_size=6,
        unique=True,
    ),
    PUBLISHERS,
    st.sampled_from(EPISODES),
)
def test_verdicts_in_spite_of_losses_are_those_without(
    drawn: Drawn,
    span: tuple[int, int],
    topics: set[str] | None,
    batch: int,
    formulas: list[str],
    publishers: int | None,
    start: EpisodeStart,
) -> None:
    """A verdict is certain, or there is none, over streams of all kinds and from all states."""
    whole = made(drawn)
    times = [each.log_time for each in whole]
    first = times[span[0] % len(times)]
    last = times[min(span[0] % len(times) + span[1], len(times) - 1)]
    left = [
        each
        for each in whole
        if not (first <= each.log_time <= last and (topics is None or each.topic in topics))
    ]
    if {each.topic for each in left} < {each.topic for each in whole}:
        return
    requested = [RequestedFormula(each) for each in formulas]
    expected = evaluate_recording(recording(whole, batch, publishers), requested, FILES, start)
    damaged = recording(left, batch, publishers)
    damaged._opening.lose('place', 'reason', topics=topics, first=first, last=last)
    found = evaluate_recording(damaged, requested, FILES, start)
    # If the last messages are lost, the recording ends earlier, perhaps before a verdict.
    unlike = {Outcome.ERROR} if left[-1] is whole[-1] else {Outcome.ERROR, Outcome.UNDECIDED}
    for one, other in zip(found.formulas, expected.formulas, strict=True):
        if other.outcome is not Outcome.ERROR and one.outcome not in unlike:
            assert one.outcome == other.outcome, one.formula
        begun = {each.begin: each for each in other.episodes}
        for episode in one.episodes:
            if episode.verdict is Verdict.UNDECIDED or other.error is not None:
                continue
            whole_one = begun[episode.begin]
            assert episode.verdict == whole_one.verdict, one.formula
            # A state that would have decided earlier may be missing.
            assert (episode.decided_at or 0) >= (whole_one.decided_at or 0), one.formula


@pytest.mark.parametrize(
    ('formula', 'trigger'),
    [
        *product(
            (
                'once "/a".v > 2',
                'historically "/a".v > 0',
                '("/a".v > 0) since[0 s, 2 s] "/a".v > 2',
                'previous "/a".v > 2',
                'count("/a".v > 2, 1 s) > 0',
                'prev("/a".v) > 2',
            ),
            ('', '"/a".v < 1'),
        ),
        ('"/a".v > 1', '"/a".v < 2'),
        ('"/a".v > 1', '"/a".v < 1 and not (once "/a".v > 2)'),
    ],
)
def test_no_verdict_depends_on_lost_first_states(formula: str, trigger: str) -> None:
    start = EpisodeStart(every=Every.TRIGGER if trigger else Every.STATE, trigger=trigger)
    damaged = recording([sample('/a', number / 10, v=int(number < 8)) for number in range(10)])
    damaged._opening.lose('place', 'reason', first=at(-1), last=at(-0.05))
    (found,) = evaluate_recording(damaged, [RequestedFormula(formula)], FILES, start).formulas
    assert found.outcome == Outcome.ERROR
    assert 'the verdict depends on messages that are lost' in str(found.error)
    assert not found.episodes
