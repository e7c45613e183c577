"""Formulas over the messages that are about to pass."""

from __future__ import annotations

import pytest

from dyknow_common import Alternatives, LanguageError
from dyknow_reactions.guard.command_formulas import CommandFormula
from dyknow_reactions.guard.watched_formula import WatchedFormula
from dyknow_reasoning import FormulaGroup, UnknownFeatures

TOPIC = '/cmd_vel_in'
SPEED = '"/cmd_vel_in".linear.x'


def formula(text: str, **units: str) -> CommandFormula:
    return CommandFormula(text, TOPIC, units)


def begun(text: str) -> CommandFormula:
    found = formula(text)
    found.begin({'Rover': ['r1', 'r2']})
    return found


def test_what_a_formula_needs() -> None:
    limit = formula(f'always {SPEED} < 0.5')
    assert limit.fields == {SPEED: 'linear.x'}
    assert (limit.state_formula, limit.sorts) == ('', [])
    both = formula(
        f'forall r in Rover: {SPEED} > 0.5 and not docked -> Ahead[r] > 1 or "/odom".x = "a"'
    )
    never = 'always[500000 h, 500000 h]'
    assert both.state_formula == (
        f'(({never} (docked))) and (forall r in Rover: ({never} (Ahead[r] = Ahead[r]))) and '
        f'(({never} ("/odom".x = "/odom".x)))'
    )
    assert both.sorts == ['Rover']
    group = FormulaGroup()
    group.add_formula('', both.state_formula)
    group.begin({'Rover': ['r1', 'r2']})
    assert {str(each) for each in group.symbols()} == {
        'docked', 'Ahead[r1]', 'Ahead[r2]', '"/odom".x'
    }  # fmt: skip


def test_a_feature_with_one_variable_twice() -> None:
    found = formula(f'forall r in Rover: {SPEED} < Gap[r, r]').state_formula
    assert found == '(forall r in Rover: (always[500000 h, 500000 h] (Gap[r, r] = Gap[r, r])))'
    FormulaGroup().add_formula('', found)


def test_states_are_presumably_fine() -> None:
    states = formula(f'{SPEED} > 0.5 and not docked and Mode = "a" -> Ahead > 1').state_formula
    group = FormulaGroup()
    number = group.add_formula('', states)
    group.begin({}, UnknownFeatures({'Ahead': (0.0, 9.0)}))
    for time, ahead in enumerate((2.0, float('nan'), 0.5)):
        assert not group.progress(time, {'docked': True, 'Mode': 'b', 'Ahead': ahead})
        assert not group.presumably_false(number)


def test_a_command_that_would_violate_it_is_refused() -> None:
    limit = begun(f'{SPEED} < 0.5')
    assert limit.refusal(1, {SPEED: 0.4}) == ''
    assert limit.refusal(2, {SPEED: 0.5}) == '"/cmd_vel_in".linear.x is 0.5'
    assert 'not a number' in limit.refusal(3, {SPEED: float('nan')})


def test_a_refused_command_is_not_part_of_the_history() -> None:
    steps = begun(f'{SPEED} > 0.5 -> previous {SPEED} > 0.2')
    assert steps.refusal(1, {SPEED: 0.9})
    assert steps.refusal(2, {SPEED: 0.9})
    assert not steps.refusal(3, {SPEED: 0.3})
    steps.accept()
    assert not steps.refusal(4, {SPEED: 0.9})


def test_the_latest_states_count() -> None:
    near = begun(f'forall r in Rover: {SPEED} > 0.5 -> Ahead[r] > 1')
    assert "no field 'Ahead[r1]'" in near.refusal(1, {SPEED: 0.9})
    near.set_state({'Ahead[r1]': 2.0, 'Ahead[r2]': 2.0})
    assert not near.refusal(1, {SPEED: 0.9})
    near.set_state({'Ahead[r1]': 2.0, 'Ahead[r2]': 0.5})
    assert near.refusal(1, {SPEED: 0.9})
    assert not near.refusal(1, {SPEED: 0.4})


def test_nothing_passes_before_the_objects_are_known() -> None:
    assert formula(f'{SPEED} < 0.5').refusal(1, {SPEED: 0.1}) == (
        'the objects of its sorts are not known yet'
    )


def test_units_of_features() -> None:
    near = formula(f'{SPEED} > 0.5 -> Ahead > 30 cm', Ahead='m', Other='kg')
    near.begin({})
    near.set_state({'Ahead': 0.4})
    assert not near.refusal(1, {SPEED: 0.9})
    near.set_state({'Ahead': 0.2})
    assert near.refusal(1, {SPEED: 0.9})


def test_the_future_is_refused() -> None:
    with pytest.raises(LanguageError, match='looks into the future'):
        formula(f'{SPEED} > 0.5 -> eventually[0 s, 1 s] p')


def test_a_watched_formula_holds_again() -> None:
    watched = WatchedFormula('forall r in Rover: (Ahead[r] > 1)', {'Rover': ['r1']})
    assert watched.failure(1, {'Ahead[r1]': 2.0}) == ''
    assert watched.failure(2, {'Ahead[r1]': 0.5}).startswith('for r = r1: Ahead[r1] = 0.5')
    assert watched.failure(3, {'Ahead[r1]': 2.0}) == ''


def test_a_response_that_is_late_fails_when_that_becomes_known() -> None:
    watched = WatchedFormula('p -> eventually[0 ns, 2 ns] q', {})
    states = [(1, 1, 0), (2, 0, 0), (4, 0, 0), (5, 1, 0), (6, 0, 1)]
    found = [watched.failure(t, {'p': bool(p), 'q': bool(q)}) for t, p, q in states]
    assert [bool(each) for each in found] == [False, False, True, False, False]
    assert 'q' in found[2]


def test_a_kept_value_is_compared_with_later_states() -> None:
    watched = WatchedFormula('let v = Ahead in eventually[0 ns, 2 ns] Ahead < v', {})
    states = [(1, 5.0), (2, 4.0), (3, 3.0), (4, 6.0), (5, 6.0), (6, 7.0), (7, 2.0), (9, 1.0)]
    found = [watched.failure(t, {'Ahead': ahead}) for t, ahead in states]
    # No lower value comes until 5 after that of 3, nor until 6 after that of 4.
    assert [each for each, reason in zip(states, found, strict=True) if reason] == states[4:6]


def test_a_kept_value_is_refused_in_a_formula_about_messages() -> None:
    with pytest.raises(LanguageError, match=r"'let v = ...' keeps a value for states to come"):
        formula(f'let v = {SPEED} in eventually[0 s, 1 s] {SPEED} < v')


def test_a_formula_that_may_be_false_does_not_hold() -> None:
    unknown = UnknownFeatures({'Ahead': (0.0, 9.0)})
    watched = WatchedFormula('forall r in Rover: Ahead[r] > 1', {'Rover': ['r1']}, unknown)
    assert watched.failure(1, {'Ahead[r1]': 2.0}) == ''
    want = 'undecided for want of Ahead[r1] since 3.000 s; '
    want += 'true if Ahead[r1] > 1 at 3.000 s, false if not'
    assert watched.failure(3 * 10**9, {'Ahead[r1]': float('nan')}) == want
    assert watched.failure(4 * 10**9, {'Ahead[r1]': 2.0}) == ''
    assert watched.failure(5 * 10**9, {'Ahead[r1]': 0.5}).startswith('for r = r1: Ahead[r1] = 0.5')


def test_an_unknown_value_that_makes_no_difference_passes() -> None:
    unknown = UnknownFeatures({'Ahead': (2.0, 9.0)})
    watched = WatchedFormula('Ahead > 1', {}, unknown)
    assert watched.failure(1, {'Ahead': float('nan')}) == ''


@pytest.mark.parametrize('values', [{}, {'p': 3}])
def test_an_error_is_final(values: dict[str, object]) -> None:
    watched = WatchedFormula('p', {})
    assert watched.failure(1, {'p': True}) == ''
    assert "'p'" in watched.failure(2, values)  # type: ignore[arg-type]
    assert "'p'" in watched.failure(3, {'p': True})


def test_past_over_missing_states_is_an_error() -> None:
    watched = WatchedFormula('once p', {})
    assert watched.failure(1, {'p': True}) == ''
    watched.gap()
    assert 'states that are missing' in watched.failure(2, {'p': True})


def test_a_watched_formula_does_not_hold_where_clocks_leave_it_open() -> None:
    watched = WatchedFormula('x > 2', {})
    reason = 'the clocks of a and b differ by 1 ms'
    assert not watched.failure(1, {'x': Alternatives.of((3.0, 4.0), reason)})
    assert watched.failure(2, {'x': Alternatives.of((4.0, 1.0), reason)}) == reason
    assert watched.failure(3, {'x': 1.0}).startswith('x = 1')
    assert watched.failure(4, {'x': Alternatives.of((1.0, 4.0), reason)})
    assert not watched.failure(5, {'x': 4.0})
