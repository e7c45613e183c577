"""Recordings against a reference: states that are made by hand, progressed one by one."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import TYPE, RecordedSample, at, recording

from dyknow_common import Verdict
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import CheckResult, RecordedState, check_trace, read_trace
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import Episode, FormulaReport
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.reading.trace_recording import TraceRecording

pytestmark = pytest.mark.long

MS = 1_000_000
MAX_DELAY = 200 * MS

TOPICS = ('/a', '/b')
FORMULAS = (
    'always ("/a".v < 3 or "/b".v < 3)',
    'eventually ("/a".v > 2 and "/b".v > 2)',
    'always ("/a".v > 2 -> eventually[0 s, 1 s] "/b".v > 2)',
    '"/a".v < 3 until[100 ms, 2 s] "/b".v > 3',
    'always[0 s, 1 s] "/a".v + "/b".v < 7',
    'eventually[1 s, 2 s] "/a".v = "/b".v',
    'always "/a".v < 4',
)

Drawn = list[tuple[int, int, int]]
Recorded = dict[str, list[RecordedSample]]

# Of each sample: the time since the one before, the delay until it is recorded, and the value.
SAMPLES = st.lists(
    st.tuples(st.integers(1, 900), st.integers(0, MAX_DELAY // MS), st.integers(0, 4)),
    min_size=4,
    max_size=12,
)


def messages(topic: str, drawn: Drawn, *, ordered: bool) -> list[RecordedSample]:
    """The messages of a topic; if they are ordered, none is recorded before an earlier one."""
    stamp, recorded, found = at(0), at(0), []
    for distance, delay, value in drawn:
        stamp += distance * MS
        recorded = max(recorded, stamp + delay * MS) if ordered else stamp + delay * MS
        found.append(RecordedSample(recorded, topic, TYPE, stamp, {'v': value}))
    return found


def states(recorded: Recorded, until: int) -> list[RecordedState]:
    """The states of a `sync`: at each stamp of a topic, the latest values of all."""
    found = []
    for tick in sorted({each.stamp or 0 for one in recorded.values() for each in one}):
        values = {
            f'"{topic}".v': [each.fields['v'] for each in one if (each.stamp or 0) <= tick][-1:]
            for topic, one in recorded.items()
        }
        if tick <= until and all(values.values()):
            found.append(RecordedState(tick, {name: value for name, (value,) in values.items()}))
    return found


def used(formula: str, recorded: Recorded) -> Recorded:
    return {topic: one for topic, one in recorded.items() if topic in formula}


def agrees(found: FormulaReport, expected: CheckResult) -> None:
    (episode,) = found.episodes
    assert (episode.verdict, episode.decided_at) == (expected.verdict, expected.decided_at)
    if expected.verdict is not Verdict.UNDECIDED:
        assert episode.explanation == expected.explanation
    elif expected.states:
        assert expected.explanation.endswith(f'what remains: {episode.residual_formula}')


@given(SAMPLES, SAMPLES)
def test_ordered_samples(first: Drawn, second: Drawn) -> None:
    drawn = zip(TOPICS, (first, second), strict=True)
    recorded = {topic: messages(topic, each, ordered=True) for topic, each in drawn}
    source = recording([each for one in recorded.values() for each in one])
    report = evaluate_recording(source, [RequestedFormula(each) for each in FORMULAS])
    for formula, found in zip(FORMULAS, report.formulas, strict=True):
        inputs = used(formula, recorded)
        # A state is complete once each input has delivered a sample as late.
        until = min(one[-1].stamp or 0 for one in inputs.values())
        agrees(found, *check_trace([formula], {}, states(inputs, until)))


@given(SAMPLES, SAMPLES)
def test_samples_in_any_order(first: Drawn, second: Drawn) -> None:
    drawn = zip(TOPICS, (first, second), strict=True)
    recorded = {topic: messages(topic, each, ordered=False) for topic, each in drawn}
    last = max(each.stamp or 0 for one in recorded.values() for each in one)
    # Then the clock shows that no sample can be missing.
    end = RecordedSample(last + MAX_DELAY + MS, '/end', TYPE, None, {'v': 0})
    text = ';'.join(
        f'stream {topic[1:]} = select v from "{topic}" with max_delay = 200 ms; sink {topic[1:]}'
        for topic in TOPICS
    )
    source = recording([*(each for one in recorded.values() for each in one), end])
    formulas = [each.replace('"/a"', 'a').replace('"/b"', 'b') for each in FORMULAS]
    with TemporaryDirectory() as folder:
        path = Path(folder, 'a.streams')
        path.write_text(text)
        report = evaluate_recording(
            source, [RequestedFormula(each) for each in formulas], MonitoringFiles(streams=(path,))
        )
    for formula, found in zip(FORMULAS, report.formulas, strict=True):
        (expected,) = check_trace([formula], {}, states(used(formula, recorded), last))
        (episode,) = found.episodes
        assert (episode.verdict, episode.decided_at) == (expected.verdict, expected.decided_at)


@given(st.lists(st.tuples(st.integers(1, 900), st.integers(0, 4)), min_size=1, max_size=12))
def test_traces_as_the_command_check_decides_them(rows: list[tuple[int, int]]) -> None:
    times = accumulate(time for time, _ in rows)
    lines = [
        'time_ms,v,w',
        *(f'{now},{v},{v / 2}' for now, (_, v) in zip(times, rows, strict=True)),
    ]
    formulas = ['always v < 3', 'eventually[0 s, 1 s] w > 1.2', 'v < 3 until[100 ms, 2 s] w = 2']
    with TemporaryDirectory() as folder:
        path = Path(folder, 'trace.csv')
        path.write_text('\n'.join(lines))
        # Both commands read a trace by the same reader, but make states of it each in its own way.
        report = evaluate_recording(
            TraceRecording(path), [RequestedFormula(each) for each in formulas]
        )
    expected = check_trace(formulas, {}, read_trace(lines))
    for found, each in zip(report.formulas, expected, strict=True):
        agrees(found, each)


@given(SAMPLES, st.sampled_from([each for each in FORMULAS if '/b' not in each]))
def test_an_episode_at_every_state(drawn: Drawn, formula: str) -> None:
    recorded = messages('/a', drawn, ordered=True)
    report = evaluate_recording(
        recording(recorded), [RequestedFormula(formula)], start=EpisodeStart(every=Every.STATE)
    )
    trace = states({'/a': recorded}, recorded[-1].stamp or 0)
    episodes = report.formulas[0].episodes
    assert len(episodes) == len(trace)
    for first, episode in enumerate(episodes):
        (expected,) = check_trace([formula], {}, trace[first:])
        assert outcome(episode) == (
            trace[first].valid_time,
            expected.verdict,
            expected.decided_at,
        )


@given(SAMPLES, st.integers(0, 2), st.sampled_from(list(Every)))
def test_all_episodes_have_the_same_past(drawn: Drawn, shortest: int, every: Every) -> None:
    recorded = messages('/a', drawn, ordered=True)
    start = EpisodeStart(every=every, trigger='once[0 s, 1 s] "/a".v = 2')
    formula = f'once[{shortest} s, 2 s] "/a".v = 1'
    report = evaluate_recording(recording(recorded), [RequestedFormula(formula)], start=start)
    trace = states({'/a': recorded}, recorded[-1].stamp or 0)
    triggered = [within(trace, i, 0, 1, 2) for i in range(len(trace))]
    complete_from = trace[0].valid_time + 2000 * MS
    begins = {
        Every.STATE: range(len(trace)),
        Every.FIRST: range(1),
        Every.COMPLETE: [i for i in range(len(trace)) if trace[i].valid_time >= complete_from][:1],
        Every.TRIGGER: [
            i for i, now in enumerate(triggered) if now and not any(triggered[i - 1 : i])
        ],
    }[every]
    expected = []
    for i in begins:
        verdict = Verdict.TRUE if within(trace, i, shortest, 2, 1) else Verdict.FALSE
        expected.append((trace[i].valid_time, verdict, trace[i].valid_time))
    assert list(map(outcome, report.formulas[0].episodes)) == expected


def within(trace: list[RecordedState], i: int, least: int, most: int, value: int) -> bool:
    """Once, between some seconds ago, there was a value."""
    now = trace[i].valid_time
    ages = ((now - each.valid_time, each.values['"/a".v']) for each in trace[: i + 1])
    return any(least <= age / (1000 * MS) <= most and found == value for age, found in ages)


def outcome(episode: Episode) -> tuple[int | None, Verdict, int | None]:
    return episode.begin, episode.verdict, episode.decided_at
