"""EvaluateFormula, asked by another node, over telemetry that the test controls."""

from __future__ import annotations

import re

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import EvaluateFormula, StreamDestroy

from evaluations import Evaluations, Spares
from system import Batteries, System, assert_decided

SYNTACTIC = EvaluateFormula.Request.SYNTACTIC
SECOND = 1_000_000_000


pytestmark = pytest.mark.usefixtures('calm')


def test_a_true_formula(system: System) -> None:
    answer = system.evaluate('forall u in UAV: always[0 s, 1 s] Power[u] < 150')
    assert_decided(answer, FormulaResult.TRUE)
    assert answer.canonical_formula == 'forall u in UAV: (always[0 s, 1 s] (Power[u] < 150))'
    assert answer.decided_at.sec > 0


def test_the_status_counts_the_state_that_decides(system: System, evaluations: Evaluations) -> None:
    answer = system.evaluate('Power[uav1] < 150')
    assert_decided(answer, FormulaResult.TRUE)
    system.client.spin_until(
        lambda: (
            evaluations.latest.states_progressed == 1
            and evaluations.latest.latest_valid_time == answer.decided_at
        ),
        'the only state',
        instead=evaluations.told,
    )


@pytest.mark.parametrize(
    ('formula', 'verdict'),
    [
        ('1 < 2', FormulaResult.TRUE),
        ('forall u in UAV: u = u', FormulaResult.TRUE),
        ('exists u in UAV: u != u', FormulaResult.FALSE),
    ],
)
def test_a_formula_that_needs_no_state_is_decided_at_zero(
    system: System, formula: str, verdict: int
) -> None:
    answer = system.evaluate(formula)
    assert_decided(answer, verdict)
    assert (answer.decided_at.sec, answer.decided_at.nanosec) == (0, 0)
    assert 'whatever the states are' in answer.explanation


def test_a_false_formula_says_which_vehicle_and_why(system: System, batteries: Batteries) -> None:
    future = system.ask('forall u in UAV: always Power[u] < 150')
    system.wait_until_running(future)
    batteries.power['uav2'] = 240.0
    answer = system.decided(future, FormulaResult.FALSE)
    assert 'Power[uav2] = 24' in answer.explanation
    assert 'uav1' not in answer.explanation


def test_the_sorts_of_variables_follow_from_the_ontology(system: System) -> None:
    # The first query starts a process, which takes seconds on a busy machine.
    answer = system.evaluate('forall u: always[0 s, 1 s] Power[u] < 150')
    assert answer.verdict == FormulaResult.TRUE, answer.exit_status.message
    answer = system.evaluate('□ ∀uav: (Power(uav) > 150 → ◊[0, 1 s] Power(uav) ≤ 150)', timeout=8.0)
    assert answer.exit_status.code == ExitStatus.TIMEOUT, answer.exit_status.message
    assert answer.canonical_formula == (
        'always (forall uav in Vehicle: ((Power[uav] > 150) -> '
        '(eventually[0 s, 1 s] (Power[uav] <= 150))))'
    )
    for formula, fault in (
        ('forall u: always Powr[u] < 150', 'the ontology has none for argument 1 of Powr'),
        ('forall u: Power[u] > 1 and exists v: v != uav1', 'no feature has it as an argument'),
    ):
        answer = system.evaluate(formula)
        assert answer.exit_status.code == ExitStatus.INVALID_ARGUMENT
        assert fault in answer.exit_status.message
        assert 'in SORT' in answer.exit_status.message


def test_numbers_are_converted_to_the_unit_of_their_feature(system: System) -> None:
    answer = system.evaluate('let most = 0.2 kW in forall u: always[0 s, 1 s] Power[u] < most')
    assert answer.verdict == FormulaResult.TRUE, answer.exit_status.message
    assert answer.canonical_formula == 'forall u in Vehicle: (always[0 s, 1 s] (Power[u] < 200.0))'
    answer = system.evaluate('eventually Power[uav1] < 2 m')
    assert answer.exit_status.code == ExitStatus.INVALID_ARGUMENT
    assert answer.exit_status.message == '\'2 "m"\' is in m, which does not convert to W'
    answer = system.evaluate('eventually "/uav1/battery".voltage > 9 V')
    assert answer.exit_status.code == ExitStatus.INVALID_ARGUMENT
    assert 'is a field of a stream, which states no unit' in answer.exit_status.message


def test_a_timeout_is_no_verdict(system: System) -> None:
    answer = system.evaluate('forall u in UAV: always Power[u] < 150', timeout=1.0)
    assert answer.exit_status.code == ExitStatus.TIMEOUT
    assert answer.verdict == FormulaResult.UNDECIDED
    assert '1 s' in answer.exit_status.message


@pytest.mark.parametrize(
    ('formula', 'code', 'message'),
    [
        ('always Power[uav1] <', ExitStatus.INVALID_ARGUMENT, r'1:21(?s:.*)\^\Z'),
        ('Power[uav1] and true', ExitStatus.INVALID_ARGUMENT, ''),
        ('  ', ExitStatus.INVALID_ARGUMENT, 'empty'),
        ('always Powr[uav1] < 150', ExitStatus.NOT_FOUND, 'Powr'),
        ('forall b in Boat: always Power[b] < 150', ExitStatus.NOT_FOUND, 'Boat'),
        ('always Power[uav9] < 150', ExitStatus.NOT_FOUND, "unknown instance 'uav9'"),
    ],
    ids=['syntax', 'type', 'nothing', 'unknown feature', 'unknown sort', 'unknown object'],
)
def test_a_wrong_formula(system: System, formula: str, code: int, message: str) -> None:
    answer = system.evaluate(formula)
    assert answer.exit_status.code == code, answer
    assert re.search(message, answer.exit_status.message)


def test_a_ground_feature_that_drops_out_needs_no_stream(system: System) -> None:
    # No stream carries XYDist[uav1, uav1]; the formula does not ask for it.
    answer = system.evaluate('forall x in UAV: x != uav1 -> always XYDist[x, uav1] > 10', 1.0)
    assert answer.exit_status.code == ExitStatus.TIMEOUT, answer.exit_status.message


@pytest.mark.parametrize(
    'body',
    ['"/uav1/battery".voltage > 9', '"/uav1/battery".cell_voltage[1] = 5', 'uav1_power.power > 99'],
    ids=['topic', 'element of an array', 'stream'],
)
def test_syntactic_grounding(system: System, body: str) -> None:
    answer = system.evaluate(f'eventually {body}', grounding=SYNTACTIC)
    assert_decided(answer, FormulaResult.TRUE)
    assert answer.canonical_formula == f'eventually ({body})'


def test_an_unknown_stream(system: System) -> None:
    answer = system.evaluate('eventually uav7_power.power > 99', grounding=SYNTACTIC)
    assert answer.exit_status.code == ExitStatus.NOT_FOUND
    assert 'uav7_power' in answer.exit_status.message
    assert 'uav1_power' in answer.exit_status.message


def test_telemetry_that_is_ahead_of_the_clock_is_a_violation(
    system: System, batteries: Batteries
) -> None:
    """A robot whose clock is ahead must not lead to a verdict over values of different times."""
    future = system.ask('always (Power[uav1] < 150 or Power[uav2] > 150)')
    system.wait_until_running(future)
    batteries.silent.add('uav1')
    batteries.power.update(uav1=240.0, uav2=240.0)
    batteries.publish_after_latest('uav1', 5 * SECOND)
    answer = system.client.result(future, 'the answer')
    assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION, answer
    assert answer.verdict == FormulaResult.UNDECIDED
    for word in ('uav1_battery', 'ahead of the clock', 'future: ', '100 ms allowed'):
        assert word in answer.exit_status.message


def test_periodic_telemetry_without_max_delay_that_stops_is_an_error(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """No violation is certain, as its delay has no bound."""
    spares.make('regular', 'select voltage from "/uav1/battery" with sample_period = 200 ms')
    future = system.ask('always regular.voltage > 9', timeout=60.0)
    evaluations.wait_for_state()
    batteries.silent.add('uav1')
    answer = system.client.result(future, 'the answer')
    assert answer.exit_status.code == ExitStatus.UNAVAILABLE, answer
    assert answer.verdict == FormulaResult.UNDECIDED
    assert "topic '/uav1/battery' has been silent for " in answer.exit_status.message
    spares.clear()


def test_many_calls_at_once(system: System) -> None:
    futures = [
        system.ask(f'forall u in UAV: always[0 s, 500 ms] Power[u] < {limit}')
        for limit in range(50, 150, 5)
    ]
    system.client.spin_until(lambda: all(future.done() for future in futures), 'all answers')
    verdicts = [future.result().verdict for future in futures]
    messages = {future.result().exit_status.message for future in futures}
    assert messages == {''}
    # Noise is nil: 100 W is not below 50, 55, ..., 100, and is below 105 and more.
    assert verdicts == [FormulaResult.FALSE] * 11 + [FormulaResult.TRUE] * 9


def test_states_that_somebody_destroys_are_made_anew(system: System, batteries: Batteries) -> None:
    future = system.ask('forall u in UAV: always Power[u] < 150', timeout=20.0)
    system.wait_until_running(future)
    (states,) = system.streams() - system.fleet_streams
    system.client.call(StreamDestroy, 'stream_manager/stream_destroy', stream_name=states)
    system.client.spin_until(
        lambda: bool(system.streams() - system.fleet_streams - {states}), 'other states'
    )
    batteries.power['uav2'] = 240.0
    system.decided(future, FormulaResult.FALSE)
