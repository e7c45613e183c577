"""Formulas that are evaluated again after errors: equal to a chain of checks with `--begin`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import ListedSamples, carried, recording
from test_column_states import (
    BATCHES,
    FILES,
    FORMULAS,
    MESSAGES,
    MS,
    PUBLISHERS,
    STARTS,
    STREAM_FORMULAS,
    THREE_STREAMS,
    Drawn,
    with_faults,
)

from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import FormulaReport, Outcome
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles

PERIOD = 500 * MS


def checked(
    source: ListedSamples, formula: str, files: MonitoringFiles, start: EpisodeStart
) -> FormulaReport:
    """A check without retries; the last state is told for attempts alone."""
    (report,) = evaluate_recording(source, [RequestedFormula(formula)], files, start).formulas
    return report


def delays(attempts: Sequence[FormulaReport]) -> list[int]:
    """The delay after each attempt: it doubles while attempts have no more than one state."""
    found, delay = [], PERIOD
    for each in attempts:
        delay = PERIOD if each.states > 1 else delay
        found.append(delay)
        delay = min(2 * delay, 10 * PERIOD)
    return found


def compare(
    source: ListedSamples,
    formula: str,
    files: MonitoringFiles = NO_FILES,
    start: EpisodeStart = FROM_FIRST_STATE,
) -> int:
    """Compare a check with retries with a chain of checks; return the number of attempts."""
    (found,) = evaluate_recording(
        source, [RequestedFormula(formula)], files, start, retries=True
    ).formulas
    if not found.attempts:
        expected = checked(source, formula, files, start)
        assert repr(found) == repr(expected)
        return 1
    begin = max(start.begin, source.start_time)
    reports = [each.report for each in found.attempts]
    for attempt, delay in zip(found.attempts, delays(reports), strict=True):
        assert attempt.begin == begin
        # Before the begin of the recording, states may be valid: the first attempt has them.
        asked = start if attempt is found.attempts[0] else replace(start, begin=begin)
        expected = checked(source, formula, files, asked)
        assert repr(replace(attempt.report, last_state=None)) == repr(expected)
        if attempt is not found.attempts[-1]:
            assert attempt.failed_at is not None
            assert all(each.available_time <= attempt.failed_at for each in expected.violations)
            looks = (attempt.failed_at + delay - begin) // PERIOD
            assert attempt.failed_at < begin + looks * PERIOD <= attempt.failed_at + delay
            begin += looks * PERIOD
    assert found.outcome is Outcome.ERROR
    return len(found.attempts)


@settings(max_examples=min(60, settings.default.max_examples))
@given(
    MESSAGES, st.data(), BATCHES, st.sampled_from(FORMULAS + STREAM_FORMULAS),
    st.sampled_from(STARTS), PUBLISHERS,
)  # fmt: skip
def test_attempts_are_a_chain_of_checks(
    drawn: Drawn,
    data: st.DataObject,
    batch: int,
    formula: str,
    start: EpisodeStart,
    publishers: int | None,
) -> None:
    messages = with_faults(drawn, data, 1)
    compare(recording(messages, batch, publishers), formula, FILES, start)


@settings(max_examples=min(40, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES, st.sampled_from(STARTS[:3]))
def test_attempts_choose_among_all_sources(
    drawn: Drawn, data: st.DataObject, batch: int, start: EpisodeStart
) -> None:
    messages = with_faults(drawn, data, 1)
    with carried(THREE_STREAMS):
        compare(recording(messages, batch), 'eventually[1 s, 8 s] Power + Height > 7', start=start)
