"""States made as columns, against the same states made message by message: equal reports.

Each operator is compared in test_operators_with_many; here are some of them, in recordings that
have faults.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import TYPE, ListedSamples, RecordedSample, at, carried, recording, sample

from dyknow_common import SECOND_NS, InlineText, Verdict
from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import ColumnStates, evaluate_recording
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles

pytestmark = pytest.mark.long

MS = 1_000_000
STREAMS = """
compunit value: float convert(value: float);
compunit mean: float mean(value: float);
stream low = select v from "/a" where v < 2; sink low;
stream late = select v from "/a" with max_delay = 60 ms; sink late;
stream mixed = select v from "/a" with max_delay = 60 ms, reorder = true; sink mixed;
stream rare = select v as value from "/b" where v > 1 and w != 3 with max_delay = 40 ms; sink rare;
stream steady = select v, w from "/a" with sample_period = 1 s, sample_period_deviation = 999 ms;
sink steady;
stream lively = select v from "/b" where v < 3 with max_delay = 60 ms, max_gap = 1200 ms;
sink lively;
stream feet = select value as v from convert(
    select v as value from "/b" where v < 5 with max_delay = 70 ms, given = "m", wanted = "ft");
sink feet;
stream average = mean(select v as value from "/b"); sink average;
stream joined = sync(select v as x from "/a" with max_delay = 80 ms, select v as y from "/b");
sink joined;
stream steps = sync(select v, w from "/b" with max_delay = 60 ms)
    with sample_period = 70 ms, approximation = linear;
sink steps;
stream sent = select v from "/e" with max_delay = 40 ms, max_gap = 1 s; sink sent;
stream merged = merge(select v from "/a", select v from "/b"); sink merged;
stream chosen = select v as u from merge(select v from "/b" where v > 1, select v from "/c");
sink chosen
"""
FORMULAS = (
    'always "/a".v < 4',
    'always ("/a".v < 3 or "/b".v < 3)',
    'eventually[0 s, 1 s] ("/a".v > 2 and "/b".v > 2)',
    'always ("/a".v > 2 -> eventually[0 s, 1 s] "/c".v > 2)',
    '"/b".v < 3 until[100 ms, 2 s] "/c".v > 3',
    'always ("/a".v + "/b".v + "/c".v < 11 and "/a".w < 9)',
    'always low.v < 4',
    'always "/d".v < 3',
    'always "/e".v < 5',
    'always ("/e".v < 3 or "/a".v < 3)',
    'always ("/e".v > 2 -> eventually[0 s, 500 ms] "/c".v > 2)',
)
STREAM_FORMULAS = (
    'always late.v < 4',
    'always (late.v < 4 or "/b".v < 3)',
    'eventually[0 s, 1 s] rare.value + "/a".v > 6',
    'always (mixed.v < 4 or "/b".v < 3)',
    'always steady.v + steady.w < 9',
    'always (lively.v < 2 or "/a".v < 4)',
    'always (feet.v < 10 or low.v < 1)',
    'always average.mean < 3',
    'always joined.x + joined.y < 9',
    'always (steps.v < 3 -> eventually[0 s, 1 s] steps.w < 3)',
    'always merged.v < 4',
    'always sent.v < 4',
    'always (chosen.u < 3 or late.v < 3)',
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
        st.sampled_from('aaabbcdee'),
        st.sampled_from([1, 1, 7, 20, 100, 400]),
        st.sampled_from([0, 0, 3, 50]),
        st.sampled_from([0.0, 1.0, 1.0, 2.0, 2.5, 3.0, 5.0]),
        st.sampled_from(['']),
    ),
    min_size=1,
    max_size=60,
)


def made(drawn: Drawn) -> list[RecordedSample]:
    """The messages; /c and /d have no stamps, /e has times of sending."""
    now, stamps, found = at(0), dict.fromkeys('abcde', 0), []
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
                is_sent=name == 'e',
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
    publishers: int | None = None,
) -> int:
    """Compare both ways; return the number of batches that were progressed as columns."""
    source = recording(messages, batch, publishers)
    found, taken = evaluated(source, formulas, files, start)
    requested = [RequestedFormula(each) for each in formulas]
    with mock.patch.object(ColumnStates, 'progress', return_value=False):
        observed = evaluate_recording(source, requested, files, start, keep_signals=True)
    expected = without_signals(observed)
    assert repr(replace(found, notes=())) == repr(expected)
    # Message by message, the rest of a batch is not read once all verdicts are known.
    assert {*observed.notes} <= {*found.notes}
    columns = evaluate_recording(source, requested, files, start, keep_signals=True)
    assert repr(without_signals(columns)) == repr(expected)
    assert shown(columns) == shown(observed)
    return taken


def without_signals(report: RecordingReport) -> RecordingReport:
    formulas = tuple(replace(each, signals=None) for each in report.formulas)
    return replace(report, formulas=formulas, notes=())


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


FILES = MonitoringFiles(streams=(InlineText('a.streams', STREAMS),))
BATCHES = st.sampled_from([1, 2, 5, 17, 1000])
PUBLISHERS = st.sampled_from([None, 1, 2])
SOME = st.lists(st.sampled_from(FORMULAS + STREAM_FORMULAS), min_size=1, max_size=6, unique=True)


@settings(max_examples=min(25, settings.default.max_examples))
@given(MESSAGES, BATCHES, SOME, st.sampled_from(STARTS), PUBLISHERS)
def test_plain_recordings(
    drawn: Drawn,
    batch: int,
    formulas: list[str],
    start: EpisodeStart,
    publishers: int | None,
) -> None:
    compare(made(drawn), batch, formulas, start, FILES, publishers)


@settings(max_examples=min(25, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES, SOME, st.sampled_from(STARTS), PUBLISHERS)
def test_recordings_with_faults(
    drawn: Drawn,
    data: st.DataObject,
    batch: int,
    formulas: list[str],
    start: EpisodeStart,
    publishers: int | None,
) -> None:
    compare(with_faults(drawn, data, 1), batch, formulas, start, FILES, publishers)


EXPIRING = """
stream fading = select v from "/b" where v < 3
    with max_delay = 60 ms, max_gap = 300 ms, expires = true;
sink fading;
stream fresh = select v, w from "/c" with max_delay = 60 ms, max_gap = 500 ms, expires = true;
sink fresh
"""
EXPIRING_FORMULAS = (
    'always (fading.v < 2 or "/a".v < 4)',
    'always fresh.v < 4',
    'always (fresh.w > 1 -> eventually[0 s, 1 s] fading.v < 2)',
    'always (fresh.v < 4 and fading.v < 3)',
)


@settings(max_examples=min(25, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES, st.sampled_from(STARTS[:3]), PUBLISHERS)
def test_values_that_expire(
    drawn: Drawn, data: st.DataObject, batch: int, start: EpisodeStart, publishers: int | None
) -> None:
    messages = with_faults(drawn, data)
    texts = (InlineText('e.streams', EXPIRING),)
    is_unknown = data.draw(st.booleans())
    files = MonitoringFiles(streams=texts, missing_is_unknown=is_unknown)
    compare(messages, batch, EXPIRING_FORMULAS, start, files, publishers)


@pytest.mark.parametrize('expires', [True, False])
def test_the_silence_of_a_topic_whose_values_expire_is_no_fault(*, expires: bool) -> None:
    messages = [sample('/a', time, v=1.0) for time in (0, 1, 2, 20, 21)]
    messages += [sample('/b', time, v=1.0) for time in range(22)]
    messages.sort(key=lambda each: each.log_time)
    text = (
        'stream fresh = select v from "/a" with max_delay = 60 ms, max_gap = 2 s'
        f'{", expires = true" if expires else ""}; sink fresh'
    )
    streams = (InlineText('e.streams', text),)
    files = MonitoringFiles(streams=streams, missing_is_unknown=True)
    formulas = ['always[0 s, 20 s] fresh.v > 2', 'eventually[0 s, 20 s] fresh.v > 2 or "/b".v > 2']
    formulas += ['always[0 s, 20 s] (fresh.v > 2 or eventually[0 s, 18 s] fresh.v = 1)']
    requested = [RequestedFormula(each) for each in formulas]
    report = evaluate_recording(recording(messages, 1), requested, files)
    if not expires:
        assert all('max_gap' in str(each.error) for each in report.formulas[1:])
        return
    assert not any(each.error for each in report.formulas)
    verdicts = [each.episodes[0].verdict for each in report.formulas]
    assert verdicts == [Verdict.FALSE, Verdict.UNDECIDED, Verdict.TRUE]


TWO_STREAMS = {'Power': tuple(f'stream {name} = select v as Power from "/{name}"' for name in 'ac')}
THREE_STREAMS = {
    'Power': (
        'stream p = select v as Power from "/a" with max_gap = 300 ms, max_delay = 60 ms',
        'stream q = select v as Power from "/c" with max_gap = 500 ms',
        'stream r = select v as Power from "/d"',
    ),
    'Height': (
        'stream s = select v as Height from "/b" with max_gap = 400 ms',
        'stream t = select v as Height from "/e"',
    ),
}


def with_faults(drawn: Drawn, data: st.DataObject, least: int = 0) -> list[RecordedSample]:
    """The messages, some of which are odd."""
    for _ in range(data.draw(st.integers(least, 3))):
        row = data.draw(st.integers(0, len(drawn) - 1))
        drawn[row] = (*drawn[row][:4], data.draw(st.sampled_from(ODD)))
    return made(drawn)


@settings(max_examples=min(20, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES)
def test_stand_ins(drawn: Drawn, data: st.DataObject, batch: int) -> None:
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + "/b".v > 4']
    with carried(TWO_STREAMS):
        compare(with_faults(drawn, data), batch, formulas)


@settings(max_examples=min(25, settings.default.max_examples))
@given(MESSAGES, st.data(), BATCHES, st.sampled_from(STARTS[:3]))
def test_stand_ins_of_several_features(
    drawn: Drawn, data: st.DataObject, batch: int, start: EpisodeStart
) -> None:
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + Height > 7']
    with carried(THREE_STREAMS):
        compare(with_faults(drawn, data), batch, formulas, start)


@pytest.mark.parametrize(
    'formulas', [['always Power < 4'], ['always Power < 4', 'always "/c".v < 9']]
)
def test_a_topic_begins_that_another_stream_is_made_of(formulas: list[str]) -> None:
    """The standby waits for /c, or another formula does: it is better than the /d in use."""
    times = {'d': [1.789, 2.191, 2.748, 2.749, 3.184], 'a': [2.149, 2.77, 3.611], 'c': [3.177]}
    messages = [sample(f'/{name}', each, v=1.0) for name in times for each in times[name]]
    messages = [each if each.topic == '/a' else each._replace(stamp=None) for each in messages]
    with carried(THREE_STREAMS):
        compare(messages, 5, formulas, publishers=1)
        report = evaluate_recording(recording(messages, 5, 1), [RequestedFormula(formulas[0])])
    assert report.formulas[0].events[-1].startswith('other streams are better now')


@pytest.mark.parametrize('start', STARTS[:3])
def test_a_stand_in_that_waits_for_a_topic_of_another_group(start: EpisodeStart) -> None:
    """The other group has an operator of /d, with a sample from before the stand-in was made."""
    drawn: Drawn = [
        ('a', 1, 0, 0.0, 'nan'),
        ('d', 1, 0, 0.0, ''),
        *[('a', 1, 0, 0.0, '')] * 7,
        ('a', 100, 0, 0.0, 'lacks'),
        ('e', 1, 0, 0.0, ''),
    ]
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + Height > 7']
    with carried(THREE_STREAMS):
        compare(made(drawn), 1, formulas, start)
        messages = recording(made(drawn), 1)
        report = evaluate_recording(messages, [RequestedFormula(each) for each in formulas])
    assert report.formulas[1].waits_for == '/d has fallen silent'


@pytest.mark.parametrize(
    ('drawn', 'start'),
    [
        pytest.param(
            [
                *((name, 1, 0, 0.0, '') for name in 'ebc'),
                ('a', 400, 0, 5.0, ''),
                ('b', 1, 0, 0.0, ''),
                ('a', 100, 0, 0.0, ''),
            ],
            FROM_FIRST_STATE,
            id='the first state of a standby waits',
        ),
        pytest.param(
            [
                ('a', 1, 0, 0.0, 'lacks'),
                ('d', 1, 0, 0.0, 'silent'),
                ('e', 1, 0, 0.0, ''),
                ('c', 100, 0, 0.0, ''),
                ('a', 400, 0, 0.0, ''),
                ('d', 1, 0, 0.0, ''),
            ],
            FROM_FIRST_STATE,
            id='a better source has begun since the last look',
        ),
        # Its standby shared operators with the streams of another group, which had other faults.
        pytest.param(
            [
                ('a', 1, 0, 5.0, ''),
                ('c', 1, 3, 2.0, ''),
                ('a', 400, 0, 1.0, ''),
                ('e', 400, 0, 0.0, ''),
            ],
            FROM_FIRST_STATE,
            id='a group that has ended stands by no more',
        ),
        # Without the memory of the former operator, the end of /a would go unnoticed.
        pytest.param(
            [('b', 1, 0, 0.0, ''), ('a', 400, 0, 5.0, 'silent'), ('e', 400, 0, 0.0, '')],
            EpisodeStart(begin=at(1)),
            id='the next stream shares an operator with the former one',
        ),
    ],
)
def test_other_sources(drawn: Drawn, start: EpisodeStart) -> None:
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + Height > 7']
    with carried(THREE_STREAMS):
        compare(made(drawn), 1, formulas, start)


@pytest.mark.parametrize('batch', [16, 64, 1000])
def test_a_stand_in_after_states_as_columns(batch: int) -> None:
    """The states that are kept of it were made as columns, too."""
    messages = sorted(
        [
            *regular('/a', 300, 10 * MS),
            *regular('/b', 1200, 10 * MS),
            *regular('/c', 1200, 10 * MS),
            *regular('/e', 1200, 10 * MS),
        ],
        key=lambda each: each.log_time,
    )
    formulas = ['always[0 s, 9 s] Power < 4', 'always[0 s, 9 s] Power + Height < 4']
    with carried(THREE_STREAMS):
        taken = compare(messages, batch, formulas)
        report = evaluate_recording(recording(messages), [RequestedFormula(formulas[1])])
    assert taken > (10 if batch < 100 else 2)
    (found,) = report.formulas
    assert [each.verdict for each in found.episodes] == [Verdict.TRUE]
    assert found.gaps == ()
    assert 'max_gap' in found.events[0]
    # The other stream for Height has taken over, too, and is left again.
    assert 'other streams are better now' in found.events[1]
    assert '"/b"' in found.events[1]


def test_a_silent_topic_is_replaced() -> None:
    messages = [*regular('/a', 100, 10 * MS), *regular('/c', 1000, 10 * MS)]
    with carried(TWO_STREAMS):
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
    assert compare(messages, 2, ['always "/a".v + "/b".v < 4'], EpisodeStart(begin=at(1))) == 4


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


def steady_recording() -> list[RecordedSample]:
    """Regular messages, in time; /c has no stamps, /e has times of sending."""
    found = []
    for topic, count, period, offset in (
        ('/a', 500, 10, 0),
        ('/b', 100, 50, 3),
        ('/c', 250, 20, 1),
        ('/e', 250, 20, 5),
    ):
        for n in range(count):
            time = at(0) + (n * period + offset) * MS
            values = {'v': 1.0 + n % 3 / 4, 'w': 1 + n % 2}
            stamp = None if topic == '/c' else time
            found.append(RecordedSample(time, topic, TYPE, stamp, values, topic == '/e'))
    return found


@pytest.mark.parametrize('formula', [each for each in STREAM_FORMULAS if 'average' not in each])
def test_streams_that_are_made_as_columns(formula: str) -> None:
    weak = formula.replace('< ', '< 10')
    assert compare(steady_recording(), 30, [weak], files=FILES) >= 3


def test_streams_with_a_memory_are_not_made_as_columns() -> None:
    assert not compare(steady_recording(), 64, ['always average.mean < 9'], files=FILES)


REGRESSIONS = {
    'a linear sync waits for a sample that is put in order': (
        [
            ('b', 1, 50, 0.0, ''),
            ('b', 62, 0, 0.0, ''),
            ('b', 13, 0, 1.0, ''),
            ('a', 31, 0, 2.5, ''),
        ],
        ['always (steps.v < 3 -> eventually[0 s, 1 s] steps.w < 3)'],
        Every.STATE,
    ),
    'a merge waits for a topic that has had no message': (
        [('a', 1, 3, 0.0, ''), ('a', 7, 0, 2.0, ''), ('b', 42, 50, 1.0, 'lacks')],
        ['always merged.v < 4'],
        Every.STATE,
    ),
    'a merge waits for a topic that is not recorded': (
        [
            ('b', 7, 0, 2.0, ''),
            ('a', 1, 50, 5.0, ''),
            ('a', 100, 50, 3.0, ''),
            ('b', 9, 0, 2.0, ''),
        ],
        ['always (chosen.u < 3 or late.v < 3)'],
        Every.STATE,
    ),
    'each select waits for another message of the same time': (
        [('a', 1, 0, 0.0, ''), ('a', 1, 0, 2.0, ''), ('a', 1, 3, 2.0, '')],
        ['always low.v < 4'],
        Every.STATE,
    ),
    'a periodic stream that falls silent is a fault': (
        [('a', 100, 0, 1.0, ''), ('b', 200, 0, 1.0, ''), ('a', 9, 0, 1.0, '')]
        + [('b', 400, 0, 1.0, '')] * 20,
        ['always (steady.v < 9 or "/b".v < 9)'],
        Every.FIRST,
    ),
    'states that are made again are received when they were': (
        [
            ('b', 20, 50, 2.0, ''),
            ('b', 40, 3, 1.0, ''),
            ('b', 98, 0, 5.0, ''),
            ('b', 1, 3, 1.0, 'silent'),
            ('d', 20, 0, 2.0, ''),
            ('b', 14, 0, 0.0, ''),
        ],
        ['always (steps.v < 3 -> eventually[0 s, 1 s] steps.w < 3)'],
        Every.FIRST,
    ),
    'integers among floats stay integers': (
        [('a', 1, 3, 5.0, 'int'), ('a', 9, 0, 2.0, ''), ('a', 70, 0, 5.0, 'int')],
        ['always late.v < 3', 'always "/a".v < 5'],
        Every.FIRST,
    ),
    'a sample with the stamp of the one before, which waits, is emitted at a known time': (
        [
            ('a', 1, 0, 2.0, ''),
            ('b', 100, 0, 1.0, ''),
            ('b', 1, 1, 2.0, 'equal'),
            ('a', 100, 0, 1.0, ''),
            ('b', 100, 0, 1.0, ''),
        ],
        ['always joined.x + joined.y < 9'],
        Every.FIRST,
    ),
}


@pytest.mark.parametrize('name', REGRESSIONS)
@pytest.mark.parametrize('batch', [1, 2, 1000])
def test_regressions(name: str, batch: int) -> None:
    drawn, formulas, every = REGRESSIONS[name]
    compare(made(drawn), batch, formulas, EpisodeStart(every=every), FILES)


@pytest.mark.parametrize('batch', [1, 2])
def test_a_formula_that_ends_leaves_the_messages_of_others(batch: int) -> None:
    drawn = [('a', 7, 3, 2.0, ''), ('c', 20, 0, 1.0, ''), ('a', 7, 0, 5.0, '')]
    drawn += [('b', 1, 3, 1.0, ''), ('a', 1, 0, 0.0, ''), ('b', 60, 0, 3.0, '')]
    formulas = ['always Power < 4', 'eventually[1 s, 8 s] Power + "/b".v > 4']
    with carried(TWO_STREAMS):
        compare(made(drawn), batch, formulas)
