"""States made as columns, against the same states made message by message: equal reports."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import TYPE, ListedSamples, RecordedSample, at, recording, sample

from dyknow_common import SECOND_NS, ExitCode
from dyknow_configuration import RequestedFormula
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation import evaluation
from dyknow_recordings.evaluation.column_states import ColumnStates
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles, NoVocabulary

MS = 1_000_000
STREAMS = """
stream low = select v from "/a" where v < 2; sink low;
stream both = select w as z from (select v as w from "/a"); sink both
"""
FORMULAS = (
    'always "/a".v < 4',
    'always ("/a".v < 3 or "/b".v < 3)',
    'eventually[0 s, 1 s] ("/a".v > 2 and "/b".v > 2)',
    'always ("/a".v > 2 -> eventually[0 s, 1 s] "/c".v > 2)',
    '"/b".v < 3 until[100 ms, 2 s] "/c".v > 3',
    'always ("/a".v + "/b".v + "/c".v < 11 and "/a".w < 9)',
    'always both.z < 4',
    'always low.v < 4',
    'always "/d".v < 3',
)
STARTS = (
    FROM_FIRST_STATE,
    EpisodeStart(begin=at(1)),
    EpisodeStart(every=Every.STATE),
    EpisodeStart(every=Every.TRIGGER, trigger='"/a".v > 2'),
)

# Of each message: the topic, the time since the one before, the delay, the value, what is odd.
Drawn = list[tuple[str, int, int, float, str]]
ODD = ['lacks', 'nan', 'zero', 'early', 'equal', 'ahead', 'type', 'silent', 'int', 'negative']
MESSAGES = st.lists(
    st.tuples(
        st.sampled_from('aaabbcd'),
        st.sampled_from([1, 1, 7, 20, 100, 400]),
        st.sampled_from([0, 0, 3, 50]),
        st.sampled_from([0.0, 1.0, 1.0, 2.0, 2.5, 3.0, 5.0]),
        st.sampled_from(['']),
    ),
    min_size=1,
    max_size=60,
)


def made(drawn: Drawn) -> list[RecordedSample]:
    """The messages; those of /c and /d have no stamp."""
    now, stamps, found = at(0), dict.fromkeys('abcd', 0), []
    for name, distance, delay, value, odd in drawn:
        now += distance * MS + (6 * SECOND_NS if odd == 'silent' else 0)
        stamp = max(now - delay * MS, stamps[name] + 1)
        stamp += {'early': -90 * MS, 'ahead': SECOND_NS}.get(odd, 0)
        stamp = {'zero': 0, 'equal': stamps[name], 'negative': -5}.get(odd, stamp)
        stamps[name] = max(stamp, stamps[name]) if odd != 'ahead' else stamps[name]
        found.append(
            RecordedSample(
                now,
                f'/{name}',
                'other/msg/Type' if odd == 'type' else TYPE,
                None if name in 'cd' else stamp,
                {
                    'v': {'lacks': None, 'nan': math.nan, 'int': int(value)}.get(odd, value),
                    'w': int(value),
                },
            )
        )
    return found


def evaluated(
    source: ListedSamples, formulas: Sequence[str], files: MonitoringFiles, start: EpisodeStart
) -> tuple[RecordingReport, int]:
    """The report, and the number of batches that were progressed as columns."""
    taken = 0
    progress = ColumnStates.progress

    def counted(self: ColumnStates, *arguments: object) -> bool:
        nonlocal taken
        done = progress(self, *arguments)  # type: ignore[arg-type]
        taken += done
        return done

    with mock.patch.object(ColumnStates, 'progress', counted):
        requested = [RequestedFormula(each) for each in formulas]
        return evaluate_recording(source, requested, files, start), taken


def compare(
    messages: list[RecordedSample],
    batch: int,
    formulas: Sequence[str],
    start: EpisodeStart = FROM_FIRST_STATE,
    files: MonitoringFiles = NO_FILES,
) -> int:
    """Compare both ways; return the number of batches that were progressed as columns."""
    source = recording(messages, batch)
    found, taken = evaluated(source, formulas, files, start)
    with mock.patch.object(ColumnStates, 'progress', return_value=False):
        requested = [RequestedFormula(each) for each in formulas]
        expected = evaluate_recording(source, requested, files, start)
        observed = evaluate_recording(source, requested, files, start, keep_signals=True)
    assert repr(found) == repr(expected)
    both = evaluate_recording(source, requested, files, start, keep_signals=True), observed
    for each in both:
        formulas_only = tuple(replace(formula, signals=None) for formula in each.formulas)
        assert repr(replace(each, formulas=formulas_only, notes=())) == repr(
            replace(expected, notes=())
        )
    assert shown(both[0]) == shown(both[1])
    return taken


def shown(report: RecordingReport) -> list[Any]:
    """The signals of a report, for a comparison."""
    return [
        {
            name: (each.times.tolist(), repr(each.values.tolist()), each.words)
            for name, each in found.signals.items()
        }
        | {'deciding': repr(found.deciding)}
        for formula in report.formulas
        if (found := formula.signals) is not None
    ]


@pytest.fixture(scope='module')
def files() -> Iterator[MonitoringFiles]:
    with TemporaryDirectory() as folder:
        path = Path(folder, 'a.streams')
        path.write_text(STREAMS)
        yield MonitoringFiles(streams=(path,))


BATCHES = st.sampled_from([1, 2, 5, 17, 1000])
SOME = st.lists(st.sampled_from(FORMULAS), min_size=1, max_size=6, unique=True)


@settings(max_examples=100, deadline=None)
@given(MESSAGES, BATCHES, SOME, st.sampled_from(STARTS))
def test_plain_recordings(
    files: MonitoringFiles, drawn: Drawn, batch: int, formulas: list[str], start: EpisodeStart
) -> None:
    compare(made(drawn), batch, formulas, start, files)


@settings(max_examples=150, deadline=None)
@given(MESSAGES, st.data(), BATCHES, SOME, st.sampled_from(STARTS))
def test_recordings_with_faults(
    files: MonitoringFiles,
    drawn: Drawn,
    data: st.DataObject,
    batch: int,
    formulas: list[str],
    start: EpisodeStart,
) -> None:
    for _ in range(data.draw(st.integers(1, 3))):
        row = data.draw(st.integers(0, len(drawn) - 1))
        drawn[row] = (*drawn[row][:4], data.draw(st.sampled_from(ODD)))
    compare(made(drawn), batch, formulas, start, files)


class TwoStreams(NoVocabulary):
    """A vocabulary in which two streams carry Power."""

    def matching_streams(self, concept: str) -> tuple[str, ...]:
        if concept != 'Power':
            raise RecordingError(f'no stream carries {concept}', ExitCode.NOT_FOUND)
        return tuple(f'stream {name} = select v as Power from "/{name}"' for name in 'ac')


@settings(max_examples=60, deadline=None)
@given(MESSAGES, st.data(), BATCHES)
def test_stand_ins(drawn: Drawn, data: st.DataObject, batch: int) -> None:
    for _ in range(data.draw(st.integers(0, 3))):
        row = data.draw(st.integers(0, len(drawn) - 1))
        drawn[row] = (*drawn[row][:4], data.draw(st.sampled_from(ODD)))
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + "/b".v > 4']
    with mock.patch.object(evaluation, 'load_vocabulary', return_value=TwoStreams({})):
        compare(made(drawn), batch, formulas)


def test_a_silent_topic_is_replaced() -> None:
    messages = [*regular('/a', 100, 10 * MS), *regular('/c', 1000, 10 * MS)]
    with mock.patch.object(evaluation, 'load_vocabulary', return_value=TwoStreams({})):
        taken = compare(messages, 64, ['always Power < 4'])
        report = evaluate_recording(recording(messages), [RequestedFormula('always Power < 4')])
    assert taken > 3
    assert "topic '/a' has been silent for 5 s" in report.formulas[0].events[0]


def regular(topic: str, count: int, period: int, value: float = 1.0) -> list[RecordedSample]:
    return [
        RecordedSample(at(0) + n * period, topic, TYPE, at(0) + n * period, {'v': value})
        for n in range(count)
    ]


def test_plain_batches_are_progressed_as_columns() -> None:
    messages = [*regular('/a', 500, 10 * MS), *regular('/b', 100, 49 * MS)]
    formulas = ['always ("/a".v < 3 and "/b".v < 2)', 'always "/a".v < 2']
    assert compare(messages, 64, formulas) == 10


def test_a_fault_leaves_the_batches_after_it_to_columns() -> None:
    messages = [*regular('/a', 500, 10 * MS), *regular('/b', 100, 50 * MS)]
    messages[250] = messages[250]._replace(stamp=at(0))
    formulas = ['always "/a".v < 2', 'always "/b".v < 2']
    assert compare(messages, 64, formulas) >= 7


@pytest.mark.parametrize('waiting', [9_990, 10_050])
def test_messages_that_wait_for_another_topic(waiting: int) -> None:
    messages = [*regular('/a', waiting, MS // 10), *regular('/b', 3, waiting * MS // 10)]
    compare(messages, 1 << 14, ['always "/a".v + "/b".v < 3'])
    compare(messages, 1 << 10, ['always "/a".v + "/b".v < 3'])


@pytest.mark.parametrize(
    'change',
    [
        {'fields': {'v': None}},
        {'fields': {'v': math.nan}},
        {'stamp': 0},
        {'stamp': at(0)},
        {'stamp': at(50)},
        {'stamp': None},
        {'message_type': 'other/msg/Type'},
    ],
    ids=repr,
)
@pytest.mark.parametrize('row', [70, 99])
def test_one_fault(change: dict[str, Any], row: int) -> None:
    messages = [*regular('/a', 100, 10 * MS), *regular('/b', 20, 50 * MS, 2.0)]
    messages[row] = messages[row]._replace(**change)
    formulas = ['always "/a".v + "/b".v < 4', 'always "/a".v < 3']
    assert compare(messages, 10, formulas) >= 7
    assert compare(messages, 1, formulas) >= 70


def test_values_from_before_the_begin_are_not_used() -> None:
    times = (0.9, 1.1, 1.2, 1.3, 1.4, 2.1, 2.2, 2.3)
    messages = [sample('/a', each, v=1.0) for each in times]
    messages += [sample('/b', each, v=1.0) for each in (0.5, 2.0)]
    assert compare(messages, 2, ['always "/a".v + "/b".v < 4'], EpisodeStart(begin=at(1))) == 1


def test_a_stamp_before_one_at_zero_is_out_of_order() -> None:
    """A message whose stamp is zero is valid at its log time, also for what follows as columns."""
    drawn = [
        ('b', 1, 0, 0.0, ''),
        ('a', 1, 0, 0.0, ''),
        ('a', 1, 0, 0.0, 'zero'),
        ('a', 1, 3, 0.0, ''),
    ]
    formulas = ['always "/a".v < 4']
    source = recording(made(drawn), 1)
    report, taken = evaluated(source, formulas, NO_FILES, FROM_FIRST_STATE)
    (formula,) = report.formulas
    assert [each.constraint for each in formula.violations] == ['valid_time_order']
    assert taken
    compare(made(drawn), 1, formulas)
