"""Formulas that are evaluated again after errors: equal to a chain of checks with `--begin`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import ListedSamples, RecordedSample, at, carried, recording, sample
from running_checks import run_check
from test_check_outputs import faults
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

from dyknow_common import InlineText
from dyknow_common.executables import ERROR
from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import ColumnStates, evaluate_recording
from dyknow_recordings.evaluation.results import (
    Attempt,
    FormulaReport,
    Outcome,
    RecordingReport,
    report_of_attempts,
)
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles
from dyknow_recordings.reporting.judgement import Judgement, reasons
from dyknow_recordings.reporting.pictures.timeline import extent, segments
from dyknow_recordings.reporting.verdict_messages import verdict_number
from dyknow_recordings.reporting.verdict_recording import status_changes

pytestmark = pytest.mark.long

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


@settings(max_examples=min(30, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES, st.lists(st.sampled_from(FORMULAS), min_size=2, unique=True))
def test_a_formula_without_an_error_has_the_same_results_beside_others(
    drawn: Drawn, data: st.DataObject, batch: int, formulas: list[str]
) -> None:
    source = recording(with_faults(drawn, data, 1), batch)
    requested = [RequestedFormula(each) for each in formulas]
    before = evaluate_recording(source, requested).formulas
    after = evaluate_recording(source, requested, retries=True, keep_signals=True).formulas
    for each, other in zip(before, after, strict=True):
        first = other.attempts[0].report if other.attempts else replace(other, signals=None)
        assert repr(replace(first, last_state=None)) == repr(each)


LATE = [sample('/a', time / 10, delay=1.2 if time == 5 else 0, v=1.0) for time in range(50)]
FALSE = [sample('/a', 5 + time / 10, v=9.0) for time in range(5)]


def report_of(messages: Sequence[RecordedSample], formula: str) -> RecordingReport:
    return evaluate_recording(recording(messages), [RequestedFormula(formula)], retries=True)


def test_a_false_formula_is_not_hidden_behind_an_error() -> None:
    report = report_of([*LATE, *FALSE], 'always "/a".v < 4')
    (formula,) = report.formulas
    late, after = formula.attempts
    assert (late.failed_at, after.begin, after.failed_at) == (at(1.7), at(2), None)
    assert formula.outcome is Outcome.ERROR
    assert formula.outcome_text == 'error, false'
    assert formula.failure is not None
    assert formula.failure.decided_at == at(5)
    counts, false, error, *_ = reasons(formula)
    assert counts == '2 episodes: 1 error, 1 false'
    assert false.startswith('false at 1700000005.000 s: ')
    assert error.startswith("error at 1700000001.700 s: stream '/a': the sample")
    assert Judgement.AUTO.exit_code([report]) == ERROR
    outcomes = [(each.span.start, each.outcome) for each in segments(formula, extent(report))]
    assert outcomes == [
        (at(0), Outcome.UNDECIDED),
        (at(1.6), Outcome.ERROR),
        (at(2), Outcome.UNDECIDED),
        (at(5), Outcome.FALSE),
    ]
    numbers = [
        (each.log_time, verdict_number(each.status), each.episode)
        for each in status_changes(report)
    ]
    assert numbers == [
        (at(0), 0, None), (at(1.7), -2, 0), (at(2), 0, None), (at(5), -1, 1),
    ]  # fmt: skip


@pytest.mark.parametrize('retries', [False, True])
def test_a_false_episode_is_not_hidden_behind_a_later_error(*, retries: bool) -> None:
    requested = [RequestedFormula('always "/a".v < 4')]
    start = EpisodeStart(every=Every.TRIGGER, trigger='"/a".v > 2')
    source = recording([sample('/a', 0.05, v=9.0), *LATE])
    report = evaluate_recording(source, requested, start=start, retries=retries, keep_signals=True)
    (formula,) = report.formulas
    outcomes = [(each.span.start, each.outcome) for each in segments(formula, extent(report))]
    assert outcomes == [(at(0.05), Outcome.FALSE), (at(1.6), Outcome.ERROR)]


@pytest.mark.parametrize('retries', [False, True])
def test_messages_that_cannot_be_used_are_told_of_other_formulas(*, retries: bool) -> None:
    """Neither another formula that is evaluated again hides them, nor a later begin."""
    texts = (InlineText('b.streams', 'stream low = select v from "/b"; sink low'),)
    files = MonitoringFiles(streams=texts)
    unusable = [sample('/b', time / 10, v=1.0)._replace(stamp=-5) for time in range(5)]
    requested = [RequestedFormula(each) for each in ('always low.v < 4', 'always "/a".v < 4')]
    source = recording([*unusable, *LATE])
    start = EpisodeStart(begin=at(0.5))
    report = evaluate_recording(source, requested, files, start, retries=retries)
    assert bool(report.formulas[1].attempts) == retries
    assert 'messages of /b cannot be used: ' in report.formulas[0].reason


def test_the_first_state_may_be_at_time_zero() -> None:
    reports = [FormulaReport('a', 'a', first_state=each) for each in (0, 5)]
    attempts = [Attempt(0, None, each) for each in reports]
    assert report_of_attempts(attempts).first_state == 0


def test_an_error_at_each_state_ends_a_bounded_number_of_evaluations() -> None:
    messages = [sample('/a', 1.0 * time, v=math.nan) for time in range(700)]
    report = report_of(messages, 'always "/a".v < 4')
    begins = [each.begin for each in report.formulas[0].attempts]
    assert begins[:6] == list(map(at, (0, 0.5, 2, 4, 8, 13)))
    assert len(begins) == 100
    assert '\'always "/a".v < 4\' has ended with 100 errors: its last' in report.notes[-1]


@pytest.mark.parametrize('batch', [5, 1000])
@pytest.mark.parametrize('value', [1.0, math.nan])
def test_batches_are_progressed_as_columns_after_an_error(batch: int, value: float) -> None:
    """A formula that fails within one of them has all messages progressed one by one."""
    messages = [*LATE, sample('/a', 30, v=value)]
    messages += [sample('/a', 5 + time / 10, v=1.0) for time in range(200)]
    formula = 'always "/a".v < 4'
    source = recording(messages, batch)
    with mock.patch.object(ColumnStates, 'progress', return_value=False):
        (expected,) = evaluate_recording(source, [RequestedFormula(formula)], retries=True).formulas
    assert len(expected.attempts) == 2
    progress = ColumnStates.progress
    with mock.patch.object(ColumnStates, 'progress', autospec=True, side_effect=progress) as taken:
        (found,) = evaluate_recording(source, [RequestedFormula(formula)], retries=True).formulas
    assert repr(found) == repr(expected)
    if batch == 5 and value == 1:
        assert taken.call_count > len(messages) / batch  # Also in the second reading.


@pytest.mark.parametrize('formula', ['always "/a".v <', 'always "/z".v < 4', 'always "/a".q < 4'])
def test_an_error_that_no_retry_can_mend(formula: str) -> None:
    (report,) = report_of(LATE, formula).formulas
    assert report.error is not None
    assert not report.attempts


def test_the_command(tmp_path: Path) -> None:
    trace = tmp_path / 'flight.csv'
    values = ['1', '', '2', '2', '9', '9']
    rows = ''.join(f'{time},{value}\n' for time, value in enumerate(values))
    trace.write_text(f'time_s,alt: float\n{rows}')
    options = (trace, '--formula', 'always alt < 5', '--retry', '--margins')
    found = run_check(*options, '--json')
    assert found.code == ERROR
    assert faults(found.document) == []
    (formula,) = found.formulas
    attempts = [(each['failed_at_ns'], each['outcome']) for each in formula['attempts']]
    assert attempts == [(1_000_000_000, 'error'), (None, 'false')]
    assert [each['decided_at_ns'] for each in formula['episodes']] == [None, 4_000_000_000]
    assert formula['episodes'][1]['margin']['upper'] == -4.0
    junit = tmp_path / 'out.xml'
    both = run_check(trace, *options, '--jobs', 2, '--every', 'state', '--junit', junit)
    assert both.out.count('error, false') == 2
    assert junit.read_text().count('type="CONSTRAINT_VIOLATION"') == 2
    refused = run_check(*options, '--probability')
    assert 'leave out --retry' in refused.err


def test_the_command_names_the_option_once(tmp_path: Path) -> None:
    """Users did not find it, and took the rest of the recording for checked."""
    late, middle, end = (tmp_path / f'{name}.csv' for name in ('late', 'middle', 'end'))
    for path, values in (late, '1 1'), (middle, '1 - 1 1'), (end, '1 1 1 -'):
        rows = enumerate(values.replace('-', '').split(' '))
        path.write_text('time_s,alt: float\n' + ''.join(f'{t},{value}\n' for t, value in rows))
    formula = ('--formula', 'always alt < 5')
    hint = 'a formula has ended with an error before the end; --retry evaluates it again after it'
    found = run_check(middle, middle, *formula)
    assert found.code == ERROR
    assert found.out.splitlines()[-1] == hint
    assert (found.out + found.err).count('--retry') == 1
    assert hint in run_check(middle, *formula, '--every', 'state').out
    for arguments in (
        (middle, *formula, '--json'),
        (middle, *formula, '--retry'),
        (middle, *formula, '--probability'),
        (middle, '--formula', 'always alt <'),
        (middle, '--formula', 'always x < 5'),
        (end, *formula),
        (late, *formula),
    ):
        found = run_check(*arguments)
        assert '--retry' not in found.out + found.err, arguments
