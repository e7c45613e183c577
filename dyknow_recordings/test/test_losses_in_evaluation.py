"""Evaluations over recordings that lack some messages, against those over all messages."""

from __future__ import annotations

from itertools import chain

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import recording
from test_column_states import (
    BATCHES,
    FILES,
    FORMULAS,
    MESSAGES,
    PUBLISHERS,
    STREAM_FORMULAS,
    Drawn,
    made,
)

from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import Outcome

pytestmark = pytest.mark.long


@given(
    st.tuples(MESSAGES, MESSAGES, MESSAGES).map(lambda parts: [*chain(*parts)]),
    st.tuples(st.integers(0, 60), st.integers(0, 8)),
    st.sampled_from([None, {'/a'}, {'/b'}, {'/c'}, {'/a', '/c'}]),
    BATCHES,
    st.lists(st.sampled_from(FORMULAS + STREAM_FORMULAS), min_size=1, max_size=6, unique=True),
    PUBLISHERS,
)
def test_verdicts_in_spite_of_losses_are_those_without(
    drawn: Drawn,
    span: tuple[int, int],
    topics: set[str] | None,
    batch: int,
    formulas: list[str],
    publishers: int | None,
) -> None:
    """A verdict is certain, or there is none, over streams of all kinds."""
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
    expected = evaluate_recording(recording(whole, batch, publishers), requested, FILES)
    damaged = recording(left, batch, publishers)
    damaged._opening.lose('place', 'reason', topics=topics, first=first, last=last)
    found = evaluate_recording(damaged, requested, FILES)
    for one, other in zip(found.formulas, expected.formulas, strict=True):
        if Outcome.ERROR not in {one.outcome, other.outcome}:
            assert one.outcome == other.outcome, one.formula
            (episode,), (first,) = one.episodes, other.episodes
            # A state that would have decided earlier may be missing.
            assert (episode.decided_at or 0) >= (first.decided_at or 0), one.formula
