"""Signals of evaluations: all extremes, in bounded memory."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import at, carried, recording, sample

from dyknow_common import SECOND_NS
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import probability_of
from dyknow_recordings.evaluation import observation
from dyknow_recordings.evaluation.episodes import EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.observation import (
    MAX_DECIDING_STATES,
    MAX_POINTS,
    MAX_SIGNALS,
    MAX_SPANS,
    Signal,
    SignalRecorder,
    terms_of,
)
from dyknow_recordings.reporting.pictures.panels import panels
from dyknow_recordings.reporting.pictures.timeline import extent
from dyknow_recordings.reporting.verdict_recording import LogTimes

STEPS = st.lists(st.integers(1, 10**6), min_size=1, max_size=400)
NAN = float('nan')


def recorder(*formulas: str, **domains: tuple[str, ...]) -> SignalRecorder:
    return SignalRecorder(terms_of(formulas, domains), domains)


def signal(found: SignalRecorder, name: str) -> Signal:
    return found.result().signals[name]


def feed(
    found: SignalRecorder, times: Sequence[int], blocks: Sequence[int], **columns: Any
) -> None:
    """Give the states in blocks of some sizes."""
    first = 0
    for size in [*blocks, len(times)]:
        part = slice(first, first + size)
        if times[part]:
            found.states(times[part], {name: each[part] for name, each in columns.items()})
        first += size


@given(
    STEPS,
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(1, 60), max_size=20),
    st.sampled_from([0.0, 0.3]),
)
def test_a_long_signal_keeps_its_extremes(
    steps: list[int], seed: int, blocks: list[int], missing: float
) -> None:
    random = np.random.default_rng(seed)
    times = [int(each) for each in np.cumsum(steps)]
    values = random.normal(size=len(times)).round(1)
    values[random.random(len(times)) < missing] = NAN
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observation, 'MAX_SPANS', 10)
        patch.setattr(observation, 'MAX_POINTS', 50)
        found = recorder('always a < 1')
        feed(found, times, blocks, a=list(values))
        kept = signal(found, 'a')
        width = found._signals['a'].width
    assert len(kept.times) <= 50
    # Each point is one of the states.
    known = dict(zip(times, values, strict=True))
    np.testing.assert_array_equal([known[int(time)] for time in kept.times], kept.values)
    # In each span of time, the least and the greatest value are over all states.
    all_times = np.array(times)
    for span in np.unique(all_times // width):
        of_all = values[all_times // width == span]
        of_kept = kept.values[kept.times // width == span]
        assert np.isnan(of_all).any() == np.isnan(of_kept).any()
        if not np.isnan(of_all).all():
            assert (np.nanmin(of_all), np.nanmax(of_all)) == (
                np.nanmin(of_kept),
                np.nanmax(of_kept),
            )
            is_known = ~np.isnan(of_all)
            assert (
                of_all[is_known][[0, -1]].tolist() == of_kept[~np.isnan(of_kept)][[0, -1]].tolist()
            )


@given(
    STEPS,
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(1, 60), max_size=20),
    st.sampled_from([', 0 s', ', 2 s', '']),
    st.sampled_from([0, 5, 50]),
)
def test_the_bands_of_probabilities_and_of_their_numbers(
    steps: list[int], seed: int, blocks: list[int], constant: str, gap: int
) -> None:
    random = np.random.default_rng(seed)
    times = [2 * int(each) for each in np.cumsum(steps)]
    values = random.normal(size=len(times))
    values[random.random(len(times)) < 0.1] = NAN
    number = f'normal(a, s{constant})'
    texts = f'P({number} > 0 or {number} < -1)', f'P(always {number} > -4)'
    found = recorder(*(f'{each} >= 0.5' for each in texts))
    for part in (slice(gap), slice(gap, None)):
        feed(found, times[part], blocks, a=list(values[part]), s=[0.5] * len(times[part]))
        found.gap()
    of_state, of_future = (probability_of(f'{each} >= 0', {}) for each in texts)
    expected = []
    for index, (time, value) in enumerate(zip(times, values, strict=True)):
        if np.isnan(value) or index == gap > 0:
            of_future.gap()
        if np.isnan(value):
            expected.append([NAN] * 4)
            continue
        both = of_state.copied(), of_future
        for each in both:
            each.step(time, {'a': float(value), 's': 0.5})
        expected.append(
            [end for each in both for end in (each.interval().lower, each.interval().upper)]
        )
    names = list(found.result().signals)
    assert names == [f'P(({number} > 0) or ({number} < -1))', 'a', f'P(always ({number} > -4))']
    bands = []
    for name in names:
        each = signal(found, name)
        assert each.band is not None
        bands.append(np.column_stack(each.band)[np.isin(each.times, times)])
    np.testing.assert_array_equal(np.column_stack([bands[0], bands[2]]), np.array(expected))
    np.testing.assert_allclose(bands[1].T, [values - 0.98, values + 0.98], atol=1e-4)


def test_the_memory_is_flat_in_the_number_of_states() -> None:
    found = recorder('always a < 1')
    for block in range(200):
        times = np.arange(block * 5000, (block + 1) * 5000) * 10_000_000
        found.states(times, {'a': np.sin(times / 1e9)})
        assert len(found._signals['a'].times) <= MAX_POINTS
    assert len(signal(found, 'a').times) >= MAX_SPANS


def test_short_signals_are_kept_whole() -> None:
    found = recorder('always a < 1')
    times = list(range(0, MAX_POINTS * 7, 7))
    feed(found, times, [1] * 100, a=[n % 13 for n in times])
    kept = signal(found, 'a')
    assert kept.times.tolist() == times
    assert kept.values.tolist() == [n % 13 for n in times]


def test_booleans_texts_missing_values_and_arithmetic() -> None:
    found = recorder('always (p and state = "up" and 2 * a + b < 3)')
    for time, p, state, a in ((1, True, 'up', 1), (2, False, 'down', None), (3, True, 'up', 4)):
        found.states([time], {'p': [p], 'state': [state], 'a': [a], 'b': [0.5]})
    found.states([4], {'p': [True], 'a': [1], 'b': [0.5]})
    assert signal(found, 'p').words == ('false', 'true')
    assert signal(found, 'p').values.tolist() == [1, 0, 1, 1]
    assert signal(found, 'state').words == ('up', 'down')
    np.testing.assert_array_equal(signal(found, 'state').values, [0, 1, 0, NAN])
    np.testing.assert_array_equal(signal(found, '(2 * a) + b').values, [2.5, NAN, 8.5, 2.5])


def test_counts_of_objects() -> None:
    texts = [
        'always count(a[r] > 2 for r in R) < 1',
        'always count(b[r] for r in R) < 1',
        'always count(m[r] starts with "x" for r in R) < 1',
    ]
    found = recorder(*texts, R=('u', 'v'))
    columns = {'a[u]': [3, 1, None], 'a[v]': [3, 3, 3], 'b[u]': [True, True, False]}
    columns |= {'b[v]': [True, False, False], 'm[u]': ['x', 'y', 'x'], 'm[v]': ['x', 'y', 'x']}
    feed(found, [1, 2, 3], [2], **columns)
    expected = ([2, 1, NAN], [2, 1, 0], [NAN, NAN, NAN])
    for text, values in zip(texts, expected, strict=True):
        name = text.removeprefix('always ').removesuffix(' < 1')
        np.testing.assert_array_equal(signal(found, name).values, values)


def test_texts_without_number_are_few() -> None:
    found = recorder('always state = "up"')
    found.states(list(range(1, 1001)), {'state': [str(n) for n in range(1000)]})
    assert len(signal(found, 'state').words) <= 22


def test_a_division_by_zero_is_a_missing_value() -> None:
    found = recorder('always 1 / a < 3')
    found.states([1, 2], {'a': [0, 0.5]})
    assert signal(found, '1 / a').values.tolist()[1] == 2


def test_states_out_of_order_are_left_out() -> None:
    found = recorder('always a < 1')
    found.states([1, 5, 3, 5, 7], {'a': [1, 2, 3, 4, 5]})
    found.states([6], {'a': [6]})
    assert signal(found, 'a').times.tolist() == [1, 5, 7]
    assert signal(found, 'a').values.tolist() == [1, 2, 5]


def test_a_gap_interrupts_the_signals() -> None:
    found = recorder('always a < b')
    found.gap()
    found.states([1], {'a': [1], 'b': [2]})
    found.gap()
    found.states([5], {'a': [3], 'b': [4]})
    for name, values in (('a', [1, NAN, 3]), ('b', [2, NAN, 4])):
        assert signal(found, name).times.tolist() == [1, 2, 5]
        np.testing.assert_array_equal(signal(found, name).values, values)


def test_the_values_of_deciding_states() -> None:
    found = recorder('always a < 1')
    found.states(list(range(1, 10_001)), {'a': list(range(1, 10_001))})
    found.decided(7777)
    found.states([10_001], {'a': [-1]})
    found.decided(10_001)
    found.decided(99_999)
    for time in range(1, 500):
        found.decided(time)
    deciding = found.result().deciding
    assert deciding[7777] == {'a': 7777.0}
    assert deciding[10_001] == {'a': -1.0}
    assert 99_999 not in deciding
    assert len(deciding) <= MAX_DECIDING_STATES


def test_terms_for_all_objects_and_their_limit() -> None:
    names = tuple(f'u{n}' for n in range(MAX_SIGNALS + 5))
    found = recorder(
        'forall u in S: u != u0 -> (exists v in W: A[u] < B[v])', S=names[:2], W=('w',)
    )
    assert [*found.result().signals] == ['A[u0]', 'B[w]', 'A[u1]']
    many = recorder('forall u in S: always A[u] < 1', S=names).result()
    assert (len(many.signals), many.omitted) == (MAX_SIGNALS, 5)


def test_signals_go_on_after_the_deciding_state() -> None:
    source = recording([sample('/a', n / 10, p=float(n)) for n in range(50)])
    texts = ('always "/a".p < 20', 'eventually "/a".p > 30')
    report = evaluate_recording(source, list(map(RequestedFormula, texts)), keep_signals=True)
    first, second = report.formulas
    assert first.episodes[0].decided_at == at(2.0)
    assert first.signals is second.signals
    assert first.signals is not None
    assert len(first.signals.signals['"/a".p'].times) == 50
    # Between processes, the formulas share them too.
    copied = pickle.loads(pickle.dumps(report)).formulas  # noqa: S301 - our own
    assert copied[0].signals is copied[1].signals
    assert first.signals.deciding == {
        at(2.0): {'"/a".p': 20.0},
        at(3.1): {'"/a".p': 31.0},
    }


def test_without_a_report_nothing_is_kept() -> None:
    source = recording([sample('/a', n / 10, p=1.0) for n in range(5)])
    start = EpisodeStart(every=Every.STATE)
    report = evaluate_recording(source, [RequestedFormula('"/a".p > 0')], start=start)
    assert report.formulas[0].signals is None


@given(STEPS, st.integers(1, 10**7), st.lists(st.integers(1, 60), max_size=20))
def test_a_signal_with_a_window_keeps_the_values_in_it(
    steps: list[int], window: int, blocks: list[int]
) -> None:
    times = [int(each) for each in np.cumsum(steps)]
    values = [float(each) for each in steps]
    terms = terms_of(['a < 1'], {})
    found = SignalRecorder(terms, {}, window)
    feed(found, times, blocks, a=values)
    known = zip(times, values, strict=True)
    expected = [each for each in known if each[0] >= times[-1] - window]
    shown = signal(found, 'a')
    assert list(zip(shown.times.tolist(), shown.values.tolist(), strict=True)) == expected


def test_values_of_the_past_are_shown_by_their_features() -> None:
    formulas = ['always not x - prev(y) > 5 and z + 1 < 2', 'always count(b or c > 1, 1 s) < 3']
    assert list(map(str, terms_of(formulas, {}))) == ['x', 'y', 'z + 1', 'b', 'c']
    trace = recording([sample('/a', n, x=float(n * n)) for n in range(4)])
    text = 'always not "/a".x - prev("/a".x) > 4'
    (report,) = evaluate_recording(trace, [RequestedFormula(text)], keep_signals=True).formulas
    (panel,), _ = panels(report)
    assert [each.name for each in panel.signals] == ['"/a".x']
    assert not panel.thresholds


def test_signals_of_a_formula_that_has_ended_do_not_change_another() -> None:
    """The signals of /c go on after 0 s, while /c stands in for /b, with stamps out of order."""
    sources = tuple(f'stream {name} = select v as Power from "/{name}"' for name in 'abc')
    messages = [sample('/a', n / 10, v=1.0) for n in range(20)]
    messages += [sample('/b', n / 10, v=1.0) for n in range(90)]
    messages += [sample('/c', 0, v=9.0), sample('/c', 6.99, v=1.0)]
    messages += [sample('/c', 6.95, delay=0.06, v=1.0)]
    messages += [sample('/c', 7.2 + n / 10, v=1.0) for n in range(148)]
    requested = [RequestedFormula('always Power < 4'), RequestedFormula('always "/c".v < 4')]
    with carried({'Power': sources}):
        source = recording(messages, publishers=1)
        plain = evaluate_recording(source, requested)
        drawn = evaluate_recording(source, requested, keep_signals=True)
    assert plain.formulas[0].states > 200
    without = tuple(replace(each, signals=None) for each in drawn.formulas)
    assert repr(replace(drawn, formulas=without)) == repr(plain)
    assert drawn.formulas[1].signals is not None
    # The stamp out of order ends the states of /c, which nobody needs.
    assert drawn.formulas[1].signals.signals['"/c".v'].times.tolist() == [at(0), at(6.99)]


@pytest.mark.parametrize('keep_signals', [False, True])
def test_times_of_another_clock_count_from_the_first_state(*, keep_signals: bool) -> None:
    """They did from the first episode, unless there was a picture."""
    messages = [
        sample('/a', n / 10, x=float(n))._replace(stamp=(100 + n) * SECOND_NS // 10)
        for n in range(100)
    ]
    start = EpisodeStart(every=Every.TRIGGER, trigger='"/a".x > 50')
    report = evaluate_recording(
        recording(messages),
        [RequestedFormula('eventually[0 s, 1 s] "/a".x < 3')],
        start=start,
        keep_signals=keep_signals,
    )
    (episode,) = report.formulas[0].episodes
    assert (episode.begin, episode.decided_at) == (151 * SECOND_NS // 10, 161 * SECOND_NS // 10)
    assert extent(report).origin == 10 * SECOND_NS
    assert LogTimes(report).of(episode.decided_at) == at(6.1)
