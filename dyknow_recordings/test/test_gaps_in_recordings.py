"""Recordings whose states come from a stand-in after a fault, against a reference.

There is a gap unless the stand-in has a state that is as early as the last one before the fault.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import TYPE, RecordedSample, at, carried, recording

from dyknow_common import Verdict
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import FormulaGroup, FormulaResult
from dyknow_recordings.evaluation import evaluation
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.results import FormulaReport

MS = 1_000_000
FORMULAS = (
    'always Power < 4',
    'eventually Power > 3',
    'always[0 s, 2 s] Power < 4',
    'eventually[0 s, 2 s] Power > 3',
    'always (Power > 3 -> eventually[0 s, 1 s] Power < 1)',
    'Power < 4 until[1 s, 3 s] Power > 3',
)
MAIN = 'select p as Power from "/main" with max_delay = 50 ms, sample_period = 100 ms'
MATCHES = (f'stream main = {MAIN}', 'stream spare = select p as Power from "/spare"')


def series(topic: str, values: Sequence[int], first: int, period: int) -> list[RecordedSample]:
    times = [at(0) + (first + n * period) * MS for n in range(len(values))]
    return [
        RecordedSample(time, topic, TYPE, time, {'p': value})
        for time, value in zip(times, values, strict=True)
    ]


def reference(
    formula: str,
    main: Sequence[RecordedSample],
    spare: Sequence[RecordedSample],
    found: FormulaReport,
) -> FormulaResult | None:
    """The result over the states of the first stream up to its fault, and then of the second."""
    (violation,) = found.violations
    group = FormulaGroup()
    group.add_formula('', formula)
    group.begin({})
    before = [each for each in main if each.log_time <= violation.available_time]
    latest = before[-1].log_time
    after = [each for each in spare if each.log_time > latest]
    for each in before:
        if results := group.progress(each.log_time, {'Power': each.fields['p']}):
            return results[0]
    if spare[0].log_time > latest:
        group.gap()
    for each in after:
        if results := group.progress(each.log_time, {'Power': each.fields['p']}):
            return results[0]
    return None


VALUES = st.lists(st.sampled_from([0, 2, 2, 2, 5]), min_size=1, max_size=12)


@given(VALUES, VALUES, st.integers(-400, 400), st.sampled_from(FORMULAS))
def test_a_stand_in(first: list[int], second: list[int], begin: int, formula: str) -> None:
    main = series('/main', first, 0, 100)
    # The stand-in may have samples before the last one of the other stream: they are not used.
    spare = series('/spare', [5, *second], max(100 * len(main) - 100 + begin, 1), 170)
    messages = sorted([*main, *spare], key=lambda each: each.log_time)
    end = RecordedSample(at(9), '/end', TYPE, None, {'p': 0})
    with carried({'Power': MATCHES}):
        report = evaluation.evaluate_recording(
            recording([*messages, end]), [RequestedFormula(formula)]
        )
    (found,) = report.formulas
    (episode,) = found.episodes
    if not found.violations:
        # It was decided before the fault.
        assert episode.verdict is not Verdict.UNDECIDED
        return
    expected = reference(formula, main, spare, found)
    if expected is None:
        # The stand-in may have had no sample: then what is undecided is an error.
        assert episode.verdict is Verdict.UNDECIDED
        assert (found.error is not None) == any(each.before is None for each in found.gaps)
    elif expected.error is not None:
        assert str(episode.error) == str(expected.error)
    else:
        assert (episode.verdict, episode.decided_at, episode.explanation) == (
            expected.verdict,
            expected.decided_at,
            expected.explanation,
        )


@pytest.mark.parametrize(('begin', 'begins'), [(-150, [1020, 1870]), (250, [2270])])
def test_a_trigger_that_may_have_begun_to_hold_in_a_gap(begin: int, begins: Sequence[int]) -> None:
    """It begins an episode at the first state after it only if no state is missing."""
    main = series('/main', [2] * 11, 0, 100)
    spare = series('/spare', [2, 5, 5, 5, 0, 2, 5, 5], 1000 + begin, 170)[begin > 0 :]
    messages = sorted([*main, *spare], key=lambda each: each.log_time)
    with carried({'Power': MATCHES}):
        report = evaluation.evaluate_recording(
            recording([*messages, RecordedSample(at(9), '/end', TYPE, None, {'p': 0})]),
            [RequestedFormula('Power < 9')],
            start=EpisodeStart(every=Every.TRIGGER, trigger='Power > 3'),
        )
    found = [((each.begin or 0) - at(0)) // MS for each in report.formulas[0].episodes]
    assert found == begins
