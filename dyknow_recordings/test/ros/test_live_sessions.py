"""Formulas in the running system and over its recording: equal verdicts, whatever takes how long.

In random worlds, topics begin late, fall silent, violate constraints and return. Several streams
carry each feature, all with the same signal, so no verdict depends on the streams in use: it is
right, or an error or undecided because of a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from unittest import mock

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recorded import TYPE, Carriers, ListedSamples, RecordedSample, at, carried, recording
from simulated_session import Outcome, SimulatedSystem

from dyknow_common import SECOND_NS, ExitCode, Verdict
from dyknow_configuration import RequestedFormula
from dyknow_recordings.evaluation import evaluation
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import FormulaReport
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles

MS = 1_000_000
SPECIFICATIONS = {
    'Power': (
        'stream p = select v as Power from "/a" with max_gap = 300 ms, max_delay = 60 ms',
        'stream q = select v as Power from "/c" with max_gap = 500 ms',
        'stream r = select v as Power from "/d" with max_gap = 800 ms',
    ),
    'Height': (
        'stream s = select v as Height from "/b" with max_gap = 400 ms',
        'stream t = select v as Height from "/e" with max_gap = 600 ms',
    ),
}
LOW, HIGH = 1.0, 5.0
WINDOW_MS = 12_000
# Of each formula: what it is about, from the values of Power and Height.
FORMULAS: dict[str, Callable[[float, float], bool]] = {
    'always Power < 4': lambda power, _: power > 4,
    'eventually Power > 4': lambda power, _: power > 4,
    'always[0 s, 12 s] Power < 4': lambda power, _: power > 4,
    'eventually[0 s, 12 s] Power > 4': lambda power, _: power > 4,
    'always (Power < 4 or Height < 4)': lambda power, height: min(power, height) > 4,
    'always[0 s, 12 s] (Power < 4 or Height < 4)': lambda power, height: min(power, height) > 4,
    'eventually[0 s, 12 s] Power + Height > 8': lambda power, height: power + height > 8,
}
STEP_MS = 100
# The period of topics of which two messages may have one stamp.
COARSE_MS = 50
# Steps for which a signal may be high without a state: after more, a constraint is broken.
UNNOTICED = 15


@dataclass(frozen=True)
class Published:
    """A topic; all times are in milliseconds from the start.

    Args:
        silences: the start and the duration of each.
        fault: the time from which on one message lacks its field, or comes late; None without.
        is_coarse: True if each second message has the stamp of the one before; see COARSE_MS.
    """

    period: int
    begin: int = 0
    silences: Sequence[tuple[int, int]] = ()
    fault: int | None = None
    is_late: bool = False
    is_coarse: bool = False


@dataclass(frozen=True)
class World:
    """The topics, and for each feature the times at which its signal rises or falls."""

    topics: dict[str, Published]
    edges: dict[str, tuple[int, ...]]
    length: int = 30_000

    def value(self, feature: str, time: int) -> float:
        """Return the value of a feature at a time in milliseconds."""
        return HIGH if sum(each <= time for each in self.edges[feature]) % 2 else LOW

    def messages(self) -> ListedSamples:
        """Return all messages; those of different topics never come at the same time."""
        found: list[RecordedSample] = []
        for number, (name, topic) in enumerate(self.topics.items(), start=1):
            fault = topic.fault
            for count, time in enumerate(range(topic.begin + number, self.length, topic.period)):
                if any(start <= time < start + length for start, length in topic.silences):
                    continue
                value: float | None = self.value('Height' if name in 'be' else 'Power', time)
                delay = 0
                if fault is not None and time >= fault:
                    fault, value, delay = None, value if topic.is_late else None, 90
                sent = at(0) + time * MS + number * 1000
                is_second = topic.is_coarse and topic.period == COARSE_MS and count % 2
                stamp = sent - COARSE_MS * MS * is_second
                found.append(
                    RecordedSample(sent + delay * MS, f'/{name}', TYPE, stamp, {'v': value})
                )
        return recording(found)


def lasting(durations: Sequence[int], offset: int) -> tuple[int, ...]:
    """Return the edges of a signal that stays for some durations."""
    return tuple(offset + sum(durations[:end]) for end in range(1, len(durations) + 1))


TIMES = st.integers(0, 20).map(lambda second: second * 1000 + 7 * second)
PUBLISHED = st.builds(
    Published,
    period=st.sampled_from([50, 100, 170]),
    begin=st.sampled_from([0, 0, 0, 3000, 7000]),
    silences=st.lists(st.tuples(TIMES, st.sampled_from([700, 2000, 6000, 60_000])), max_size=2).map(
        tuple
    ),
    fault=st.none() | TIMES,
    is_late=st.booleans(),
    is_coarse=st.booleans(),
)
DURATIONS = st.lists(st.sampled_from([1500, 3000, 6000, 9000]), max_size=8)
EDGES = st.fixed_dictionaries(
    {
        'Power': DURATIONS.map(lambda each: lasting(each, 0)),
        'Height': DURATIONS.map(lambda each: lasting(each, 750)),
    }
)
LATER = TIMES.filter(lambda time: time > 2000)
# A topic with one defect, of which a standby knows enough.
DEFECTIVE = st.builds(
    lambda period, start, length: Published(period, silences=((start, length),)),
    st.sampled_from([50, 100, 170]),
    LATER,
    st.sampled_from([700, 2000, 6000, 60_000]),
) | st.builds(Published, st.just(100), fault=LATER, is_late=st.booleans())
REGULAR = {name: Published(100) for name in 'abcde'}


def steady(edges: tuple[int, ...] = (), **others: Published) -> World:
    """Return a world whose topics of Power are those given."""
    return World({'b': Published(100)} | others, {'Power': edges, 'Height': ()})


# With the verdict on `always Power < 4`, its second, the error and the changes of sources.
CASES = {
    'the spare breaks the formula before the best topic begins': (
        steady((3000, 3600), a=Published(100, begin=20_000), c=Published(100)),
        (Verdict.FALSE, 3, '', ['silent', '/c']),
    ),
    'a stand-in that begins later is no reason to miss a violation': (
        steady((10_000, 10_600), a=Published(100, fault=7000), c=Published(100, begin=25_000)),
        (Verdict.UNDECIDED, None, "no field 'v'", []),
    ),
    'the stand-in fails too': (
        steady(a=Published(100, fault=5000), c=Published(100, fault=8000)),
        (Verdict.UNDECIDED, None, "'q': no field 'v'", ["'p': no field", '/c']),
    ),
    'a third source replaces the second': (
        steady(
            (20_000, 20_600),
            a=Published(100, fault=5000),
            c=Published(100, fault=5300),
            d=Published(100),
        ),
        (Verdict.FALSE, 20, '', ["'p': no field", '/c', "'q': no field", '/d', 'better', '/a']),
    ),
}
# The best topic may be used again from 12 s on; the one in use fails while it is left, or after.
HAND_OVERS = [
    steady((20_000, 20_600), a=Published(100, fault=2000), c=Published(400, fault=fault))
    for fault in range(12_600, 13_600, 100)
]


WORLDS = st.builds(World, st.fixed_dictionaries(dict.fromkeys('abcde', PUBLISHED)), EDGES)


def recorded(
    messages: ListedSamples, formula: str, files: MonitoringFiles = NO_FILES
) -> FormulaReport:
    """Evaluate a formula over a recording."""
    with carried(SPECIFICATIONS):
        (report,) = evaluate_recording(messages, [RequestedFormula(formula)], files).formulas
    return report


def of_report(report: FormulaReport) -> Outcome:
    """Return what a report says, as from the running system."""
    episode = report.episodes[0] if report.episodes else None
    error = report.error or (episode.error if episode else None)
    if episode is None or error is not None:
        # The running system waits for states until its client's timeout.
        has_failed = error is not None and error.code is not ExitCode.NOT_FOUND
        return Outcome(error=error if has_failed else None, events=list(report.events))
    return Outcome(episode.verdict, episode.decided_at, events=list(report.events))


def check(world: World, formula: str, found: Outcome) -> None:
    """Check that a verdict is right: the signals are known."""
    if found.verdict is Verdict.UNDECIDED:
        return
    assert found.decided_at is not None
    end = (found.decided_at - at(0)) // MS
    # A message may have the stamp of an earlier one.
    times = range(end + COARSE_MS, max(end - WINDOW_MS, 0), -STEP_MS)
    is_about = FORMULAS[formula]
    high = [is_about(*(world.value(each, time) for each in ('Power', 'Height'))) for time in times]
    if (found.verdict is Verdict.TRUE) == formula.startswith('eventually'):
        # A value counts until the next one of its stream.
        assert any(high[:11]), 'no state is like the deciding one'
    else:
        runs = ''.join('1' if each else '0' for each in high).split('0')
        assert max(map(len, runs)) < UNNOTICED, 'the signal was high for longer than a gap may be'


def check_both(world: World, formula: str, live: Outcome) -> None:
    """Check what was found live, and over the recording, and that they agree."""
    report = recorded(world.messages(), formula)
    offline = of_report(report)
    check(world, formula, live)
    check(world, formula, offline)
    if Verdict.UNDECIDED not in {live.verdict, offline.verdict}:
        assert live.verdict is offline.verdict
    elif live.verdict is not offline.verdict:
        # Whichever has none says which states may be missing.
        other = live if live.verdict is Verdict.UNDECIDED else offline
        assert other.error is not None or other.events


def live(world: World, formula: str, seed: int | None = None) -> Outcome:
    """Evaluate a formula in the running system; with a seed, everything takes a random time."""
    if seed is None:
        return SimulatedSystem(world.messages(), formula, Carriers(SPECIFICATIONS)).run()
    random = Random(seed)  # noqa: S311 - not for cryptography
    delays = [0, 1, 10, 40, 150, 400]

    def delay(_: str) -> int:
        return random.choice(delays) * MS

    return SimulatedSystem(world.messages(), formula, Carriers(SPECIFICATIONS), delay).run()


@pytest.mark.parametrize('case', CASES)
def test_sources_that_fail(case: str) -> None:
    world, (verdict, second, error, events) = CASES[case]
    formula = 'always Power < 4'
    for found in (live(world, formula), of_report(recorded(world.messages(), formula))):
        assert found.verdict is verdict
        decided_at = None if found.decided_at is None else (found.decided_at - at(0)) // SECOND_NS
        assert decided_at == second
        assert error in str(found.error)
        text = ' '.join(found.events)
        for each in events:
            assert each in text
            text = text.split(each, 1)[1]


@pytest.mark.parametrize(('limit_s', 'verdict'), [(5.0, Verdict.FALSE), (10.0, Verdict.UNDECIDED)])
def test_silence_has_the_same_limit(limit_s: float, verdict: Verdict) -> None:
    """The topic is silent for 7 s; meanwhile, another one shows that the formula is false."""
    carriers = tuple(f'stream {each} = select v as Power from "/{each}"' for each in 'ac')
    world = steady((11_000, 11_600), a=Published(100, silences=((5000, 7000),)), c=Published(100))
    messages, formula = world.messages(), 'always Power < 4'
    files = MonitoringFiles(silence_limit=round(limit_s * SECOND_NS))
    with mock.patch.dict(SPECIFICATIONS, Power=carriers):
        system = SimulatedSystem(
            messages, formula, Carriers(SPECIFICATIONS), silence_limit_s=limit_s
        )
        for found in (system.run(), of_report(recorded(messages, formula, files))):
            assert (found.verdict, found.error) == (verdict, None)


class ExpiringHeight(Carriers):
    """A vocabulary in which the height may be unknown, and is while its only topic is silent."""

    def matching_streams(self, concept: str) -> tuple[str, ...]:
        if concept != 'Height':
            return super().matching_streams(concept)
        timing = 'max_gap = 400 ms, max_delay = 60 ms, expires = true'
        return (f'stream s = select v as Height from "/b" with {timing}',)

    def query(self, sparql: str) -> Sequence[tuple[str, ...]]:
        return [('x:Height', 'x:Height', '-inf inf')] if '#unknown' in sparql else ()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(LATER, st.sampled_from([700, 2000, 9000])), max_size=2),
    EDGES,
    st.sampled_from([each for each in sorted(FORMULAS) if 'Height' in each]),
)
def test_a_topic_whose_values_expire_may_be_silent(
    silences: list[tuple[int, int]], edges: dict[str, tuple[int, ...]], formula: str
) -> None:
    world = World(REGULAR | {'b': Published(100, silences=silences)}, edges)
    messages, vocabulary = world.messages(), ExpiringHeight(SPECIFICATIONS)
    found = SimulatedSystem(messages, formula, vocabulary).run()
    with mock.patch.object(evaluation, 'load_vocabulary', return_value=vocabulary):
        (report,) = evaluate_recording(messages, [RequestedFormula(formula)]).formulas
    offline = of_report(report)
    check(world, formula, found)
    assert (found.verdict, found.decided_at) == (offline.verdict, offline.decided_at)
    assert found.error is offline.error is None
    assert found.events == offline.events == []


@pytest.mark.parametrize('world', HAND_OVERS)
def test_a_stream_that_is_left_harms_no_other(world: World) -> None:
    formula = 'always Power < 4'
    assert of_report(recorded(world.messages(), formula)).verdict is Verdict.FALSE
    for seed in (None, 1, 2):
        assert live(world, formula, seed).verdict is Verdict.FALSE


@settings(max_examples=15, deadline=None, derandomize=True)
@given(WORLDS, st.sampled_from(sorted(FORMULAS)))
def test_without_delays(world: World, formula: str) -> None:
    check_both(world, formula, live(world, formula))


@settings(max_examples=20, deadline=None, derandomize=True)
@given(WORLDS, st.sampled_from(sorted(FORMULAS)), st.integers(0, 1000))
def test_with_delays(world: World, formula: str, seed: int) -> None:
    check_both(world, formula, live(world, formula, seed))


# Nobody listens to the best topic, as it is silent, when it may be used again.
@example(
    'a',
    Published(50, silences=((2014, 60_000),)),
    {'Power': (), 'Height': ()},
    'always (Power < 4 or Height < 4)',
)
@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.sampled_from('abcde'), DEFECTIVE, EDGES, st.sampled_from(sorted(FORMULAS)))
def test_one_defect_gives_equal_reports(
    name: str, topic: Published, edges: dict[str, tuple[int, ...]], formula: str
) -> None:
    world = World(REGULAR | {name: topic}, edges)
    offline, found = of_report(recorded(world.messages(), formula)), live(world, formula)
    assert (found.verdict, found.decided_at) == (offline.verdict, offline.decided_at)
    assert str(found.error) == str(offline.error)
    assert found.events == offline.events
