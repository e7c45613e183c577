"""Evaluations that run, drawn as reports."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Verdict
from dyknow_coordinator import (
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    StandingVerdicts,
    SymbolGrounding,
    ViolationEpisode,
)
from dyknow_dashboard.model.live_reports import live_report, strip
from dyknow_dashboard.model.live_signals import WINDOW_NS, LiveSignals, domains_of
from dyknow_recordings.reporting.pictures.timeline import Span

UNDECIDED = EvaluationStatus(
    'power',
    'forall u in UAV: always (Power[u] < 5)',
    EvaluationPhase.RUNNING,
    started=10 * SECOND_NS,
    state_stream='/states',
    states_progressed=5,
    latest_valid_time=20 * SECOND_NS,
    residual_formula='always[0 s, 3 s] (Power[uav1] < 5)',
    groundings=tuple(
        SymbolGrounding(f'Power[{name}]', Grounding.SEMANTIC, 'select a from b', ())
        for name in ('uav1', 'uav2')
    ),
)
FALSE = replace(
    UNDECIDED,
    phase=EvaluationPhase.ENDED,
    verdict=Verdict.FALSE,
    decided_at=20 * SECOND_NS,
    explanation='for u = uav2: Power[uav2] = 6 is not < 5',
)
WHOLE = Span(0, 40 * SECOND_NS)
DOMAINS = {'UAV': ('uav1', 'uav2')}


def episode(begin: int, end: int, *, has_ended: bool = True) -> ViolationEpisode:
    times = begin * SECOND_NS, end * SECOND_NS, begin * SECOND_NS
    return ViolationEpisode(*times, 3, has_ended, 'for u = uav1: too much')


def signals_of(status: EvaluationStatus, *powers: float) -> LiveSignals:
    signals = LiveSignals(status, DOMAINS)
    for number, power in enumerate(powers):
        time = status.started + number * SECOND_NS
        signals.add(time, {'Power[uav1]': 1.0, 'Power[uav2]': power})
    signals.update()
    return signals


def panel_names(drawing: dict[str, Any]) -> list[list[str]]:
    return [each['names'] for each in drawing['captions']]


def test_a_formula_is_undecided_until_it_is_decided() -> None:
    assert strip(UNDECIDED, WHOLE) == [[0.25, 0.5, 'undecided']]
    assert strip(FALSE, WHOLE) == [[0.25, 0.5, 'undecided'], [0.5, 1.0, 'false']]


def test_a_formula_without_states_has_no_verdicts() -> None:
    assert strip(replace(UNDECIDED, states_progressed=0, latest_valid_time=None), WHOLE) == []


def test_a_cancelled_formula_is_no_error() -> None:
    for code in (ExitCode.CANCELLED, ExitCode.TIMEOUT):
        ended = replace(UNDECIDED, phase=EvaluationPhase.ENDED, error=DyKnowError('it ended', code))
        assert strip(ended, WHOLE) == [[0.25, 0.5, 'undecided']]
    failed = replace(ended, error=DyKnowError('broken', ExitCode.CONSTRAINT_VIOLATION))
    assert strip(failed, WHOLE)[-1][2] == 'error'


def test_only_the_span_is_shown() -> None:
    late = Span(15 * SECOND_NS, 25 * SECOND_NS)
    assert strip(FALSE, late) == [[0.0, 0.5, 'undecided'], [0.5, 1.0, 'false']]
    assert strip(UNDECIDED, Span(30 * SECOND_NS, 40 * SECOND_NS)) == []


def test_a_standing_formula_holds_between_its_episodes() -> None:
    verdicts = StandingVerdicts(
        holds=9, fails=6, episode_count=2, latest_episodes=(episode(12, 14), episode(16, 18))
    )
    found = strip(replace(UNDECIDED, episodes=verdicts), WHOLE)
    assert [each[2] for each in found] == ['true', 'false', 'true', 'false', 'true']
    assert [each[0] for each in found] == [0.25, 0.3, 0.35, 0.4, 0.45]


def test_a_violation_that_goes_on_is_the_last_segment() -> None:
    verdicts = StandingVerdicts(
        fails=6,
        is_violated=True,
        episode_count=1,
        latest_episodes=(episode(12, 20, has_ended=False),),
    )
    found = strip(replace(UNDECIDED, episodes=verdicts), WHOLE)
    assert [each[2] for each in found] == ['true', 'false']
    assert found[-1][:2] == [0.3, 0.5]


def test_before_the_oldest_known_episode_nothing_is_claimed() -> None:
    verdicts = StandingVerdicts(
        holds=9, fails=60, episode_count=11, latest_episodes=(episode(16, 18),)
    )
    found = strip(replace(UNDECIDED, episodes=verdicts), WHOLE)
    assert found[0] == [0.4, 0.45, 'false']


def test_the_objects_that_decide_are_known_from_the_explanation() -> None:
    (only,) = live_report(FALSE).episodes
    assert only.objects == 'u = uav2'
    (running,) = live_report(UNDECIDED).episodes
    assert running.objects == ''


def test_the_drawing_of_a_decided_formula() -> None:
    drawing = signals_of(FALSE, *range(11)).drawing()
    assert panel_names(drawing) == [['Power[uav2]'], ['Power[uav1]']]
    assert drawing['captions'][0]['is_decisive']
    (formula,) = drawing['formulas']
    assert formula['panels'][0]['thresholds'] == [{'value': 5.0, 'text': '&lt; 5'}]
    (deciding,) = formula['marks']['deciding']
    assert deciding['time'] == 10
    assert deciding['values']['Power[uav2]'] == 10
    assert drawing['signals'][0]['t'] == [*range(11)]
    assert formula['range'] == [-0.1, 10.1]


def test_the_pending_window_of_an_undecided_formula() -> None:
    (formula,) = signals_of(UNDECIDED, *range(11)).drawing()['formulas']
    assert formula['marks']['pending'] == [[10, 13]]
    assert formula['range'] == [-0.13, 13.13]


def test_points_continue_a_drawing() -> None:
    signals = signals_of(UNDECIDED, 1, 2, 3)
    drawing, shape = signals.drawing(), signals.shape
    since = signals.latest
    signals.add(since + SECOND_NS, {'Power[uav1]': 1.0, 'Power[uav2]': 4.0})
    points = signals.points(since)
    assert signals.shape == shape
    assert [each['t'] for each in points['signals']] == [[3], [3]]
    assert [each['v'] for each in points['signals']] == [[1], [4]]
    names = [each['name'] for each in drawing['signals']]
    assert names == ['Power[uav1]', 'Power[uav2]']


def test_the_shape_changes_with_the_deciding_objects() -> None:
    signals = signals_of(UNDECIDED, 1, 2, 3)
    before = signals.shape
    signals.follow(FALSE, DOMAINS)
    signals.update()
    assert signals.shape != before


def test_old_states_are_forgotten() -> None:
    signals = LiveSignals(UNDECIDED, DOMAINS)
    for number in range(10_000):
        time = UNDECIDED.started + number * SECOND_NS // 10
        signals.add(time, {'Power[uav1]': 1.0, 'Power[uav2]': float(number)})
    drawing = signals.drawing()
    times = drawing['signals'][0]['t']
    assert times[-1] == 999.9
    assert times[-1] - times[0] == WINDOW_NS / SECOND_NS
    assert len(times) == WINDOW_NS // SECOND_NS * 10 + 1


def test_the_objects_are_those_of_the_streams() -> None:
    groundings = tuple(
        SymbolGrounding(f'Power[{name}]', Grounding.SEMANTIC, 'select a from b', ())
        for name in ('uav1', 'pad1', 'uav2')
    )
    status = replace(UNDECIDED, groundings=groundings)
    assert domains_of(status, {}) == {'UAV': ('uav1', 'pad1', 'uav2')}
    known = {'UAV': ('uav0', 'uav1', 'uav2')}
    assert domains_of(status, known) == {'UAV': ('uav1', 'uav2')}
    assert domains_of(replace(status, formula='always ('), known) == {}


def test_a_drawing_begins_with_the_first_state() -> None:
    signals = LiveSignals(FALSE, DOMAINS)
    for time in (15 * SECOND_NS, 20 * SECOND_NS):
        signals.add(time, {'Power[uav1]': 1.0, 'Power[uav2]': 9.0})
    assert signals.drawing()['formulas'][0]['range'] == [4.95, 10.05]


def test_thresholds_have_the_unit_of_their_feature() -> None:
    signals = signals_of(replace(FALSE, formula='forall u in UAV: always abs(Power[u]) < 5'), 5, 9)
    signals.units = {'Power': 'W'}
    (formula,) = signals.drawing()['formulas']
    assert formula['panels'][0]['unit'] == 'W'
    assert formula['panels'][0]['thresholds'] == [{'value': 5.0, 'text': '&lt; 5 W'}]


def test_a_sort_without_objects_has_no_panels() -> None:
    signals = LiveSignals(replace(UNDECIDED, groundings=()), {})
    signals.add(1, {'Power[uav1]': 1.0})
    assert signals.drawing()['captions'] == []


def test_signals_are_those_until_the_end_of_the_formula() -> None:
    signals = signals_of(UNDECIDED, *range(15))
    shape = signals.shape
    signals.follow(FALSE, DOMAINS)
    signals.update()
    assert signals.shape != shape, 'a page may have points of later states'
    signals.add(25 * SECOND_NS, {'Power[uav1]': 1.0, 'Power[uav2]': 25.0})
    drawing = signals.drawing()
    assert drawing['signals'][0]['t'] == [*range(11)], 'others may be asked over the same states'
    assert drawing['formulas'][0]['range'] == [-0.1, 10.1]
    assert signals.is_complete
    signals.follow(UNDECIDED, DOMAINS)
    assert not signals.is_complete, 'the coordinator reports it again'


def test_the_deciding_state_may_come_after_the_verdict() -> None:
    signals = signals_of(UNDECIDED, *range(5))
    signals.follow(FALSE, DOMAINS)
    assert not signals.is_complete
    signals.add(FALSE.decided_at or 0, {'Power[uav1]': 1.0, 'Power[uav2]': 9.0})
    assert signals.is_complete
    assert signals.drawing()['signals'][0]['t'][-1] == 10


def test_signals_remain_when_the_ontology_is_read() -> None:
    signals = LiveSignals(UNDECIDED, {})
    signals.add(UNDECIDED.started, {'Power[uav1]': 1.0, 'Power[uav2]': 2.0})
    signals.follow(UNDECIDED, {'UAV': ('uav2',)})
    (caption,) = signals.drawing()['captions']
    assert (caption['objects'], caption['names']) == ('u = uav2', ['Power[uav2]'])
    assert caption['title'] == 'Power[uav2] < 5'
    signals.follow(replace(UNDECIDED, formula='forall u in UAV: Height[u] > 3'), DOMAINS)
    assert signals.drawing()['captions'] == [], 'other terms have no values yet'


def test_the_latest_failure_is_the_decisive_one() -> None:
    second = replace(episode(17, 18), explanation='for u = uav2: too much')
    verdicts = StandingVerdicts(
        holds=3, fails=6, episode_count=2, latest_episodes=(episode(12, 13), second)
    )
    drawing = signals_of(replace(UNDECIDED, episodes=verdicts), *range(11)).drawing()
    assert [each['is_decisive'] for each in drawing['captions']] == [True, False]
    assert drawing['captions'][0]['objects'] == 'u = uav2'
    assert [each['time'] for each in drawing['formulas'][0]['marks']['deciding']] == [7, 2]


def test_axes_have_the_unit_of_the_formula_or_of_the_ontology() -> None:
    def unit(formula: str, units: dict[str, str]) -> str:
        signals = signals_of(replace(UNDECIDED, formula=formula), 1, 2)
        signals.units = units
        return str(signals.drawing()['formulas'][0]['panels'][0]['unit'])

    plain = UNDECIDED.formula
    with_unit = f'let Power: W in {plain.replace("5", "0.005 kW")}'
    assert unit(plain, {}) == ''
    assert unit(plain, {'Power': 'W'}) == 'W'
    assert unit(with_unit, {}) == 'W'
    assert unit('forall u in UAV: always (Power[u] * 2 < 5)', {'Power': 'W'}) == ''


def test_the_probability_at_each_state_is_a_band_and_that_of_the_future_is_not_drawn() -> None:
    """The page may have missed the first states, which the latter depends on."""
    number = 'normal(Power[uav2], 2)'
    formula = f'always (P({number} > 3) > 0.5) and P(always ({number} > 0)) > 0.1'
    signals = signals_of(replace(UNDECIDED, formula=formula), 3, 3)
    drawing = signals.drawing()
    assert panel_names(drawing) == [[f'P({number} > 3)'], ['Power[uav2]']]
    assert signals.count == 3 * 6, 'a band needs memory'
    signals.add(signals.latest + SECOND_NS, {'Power[uav1]': 1.0, 'Power[uav2]': 300.0})
    (probability, power) = signals.points(signals.latest - 1)['signals']
    assert probability['low'] == probability['high'] == [1]
    assert [round(each, 2) for each in power['high']] == [303.92]
