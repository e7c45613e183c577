"""Plans: the formulas that run are those whose time it is, after any sensible reports."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    Event,
    FormulaPosition,
    Holds,
    Plan,
    PlanAction,
    PlanExecution,
    PlanFormula,
    PlanPhase,
    PlanVerdict,
)
from dyknow_coordinator.plan import Step, withdrawal

ACTIONS = ('take_off', 'fly_to', 'land')
ORDERS = ([], [Event.STARTED], [Event.STARTED, Event.SUCCEEDED], [Event.STARTED, Event.FAILED],
          [Event.FAILED])  # fmt: skip
"""The possible reports on one action, in this order."""

EACH = tuple(PlanFormula(holds.name, 'true', holds) for holds in Holds)
PLAN = Plan(
    'mission', tuple(PlanAction(name, EACH) for name in ACTIONS), (PlanFormula('whole', 'true'),)
)
POSITIONS = tuple(PLAN.formulas_by_position)


def expected(history: list[tuple[str, Event]], position: FormulaPosition) -> PlanPhase:
    """The phase of a formula that nobody decides, read off the whole history."""
    own = [event for action, event in history if action == position.action]
    last_events = [[e for a, e in history if a == action] for action in ACTIONS]
    over = all(events and events[-1] is not Event.STARTED for events in last_events)
    over_with_this = over and history[-1][0] == position.action
    started, succeeded = Event.STARTED in own, Event.SUCCEEDED in own
    failed = Event.FAILED in own
    match position.formula:
        case 'whole' | 'BEFORE':
            begun, ended = True, over if position.formula == 'whole' else bool(own)
        case 'WHILE_EXECUTING':
            begun, ended = started, succeeded or failed
        case 'AFTER':
            # Of the action that ends the plan, the time is empty.
            begun, ended = succeeded and not over_with_this, over
        case _:
            begun, ended = started, failed or over
    if not begun:
        return PlanPhase.PENDING
    return PlanPhase.WITHDRAWN if ended else PlanPhase.RUNNING


@st.composite
def histories(draw: st.DrawFn) -> list[tuple[str, Event]]:
    """Sensible reports of all actions, in any order between actions."""
    left = {action: list(draw(st.sampled_from(ORDERS))) for action in ACTIONS}
    history = []
    while any(left.values()):
        action = draw(st.sampled_from([name for name, events in left.items() if events]))
        history.append((action, left[action].pop(0)))
    return history


@given(histories())
def test_the_formulas_that_run_are_those_whose_time_it_is(
    history: list[tuple[str, Event]],
) -> None:
    execution = PlanExecution(PLAN)
    running = set(execution.begin().start)
    for number in range(len(history) + 1):
        past = history[:number]
        if past:
            step = execution.report(*past[-1])
            assert running.issuperset(step.withdraw)
            assert running.isdisjoint(step.start)
            running = running - set(step.withdraw) | set(step.start)
        phases = {position: execution.phase(position) for position in POSITIONS}
        assert phases == {
            position: expected(past, position) for position in PLAN.formulas_by_position
        }
        assert running == {
            position for position, phase in phases.items() if phase is PlanPhase.RUNNING
        }
    finished = {action for action, event in history if event is not Event.STARTED}
    assert execution.has_ended == (finished == set(ACTIONS))
    assert not (execution.has_ended and running)


@given(histories(), st.sampled_from(ACTIONS), st.sampled_from(Event))
def test_a_report_is_refused_exactly_when_it_fits_no_order(
    history: list[tuple[str, Event]], action: str, event: Event
) -> None:
    execution = PlanExecution(PLAN)
    execution.begin()
    for report in history:
        execution.report(*report)
    own = [past for name, past in history if name == action]
    before = {position: execution.phase(position) for position in POSITIONS}
    if [*own, event] in ORDERS:
        execution.report(action, event)
    else:
        with pytest.raises(CoordinationError, match=f"'{action}' cannot have"):
            execution.report(action, event)
        assert before == {
            position: execution.phase(position) for position in PLAN.formulas_by_position
        }


def begun(plan: Plan) -> tuple[PlanExecution, Step]:
    """A plan that has just begun."""
    execution = PlanExecution(plan)
    return execution, execution.begin()


WHOLE = FormulaPosition('', 'whole')


@pytest.mark.parametrize('violation', [{'violated': True}, {'failed': True}])
@pytest.mark.parametrize('stop', [False, True])
def test_a_plan_stops_at_the_first_violation_if_it_is_to(
    violation: dict[str, bool], *, stop: bool
) -> None:
    execution, _ = begun(Plan('p', PLAN.actions, PLAN.formulas, stop_at_violation=stop))
    step = execution.conclude(WHOLE, **violation)
    assert execution.has_ended == stop
    before = tuple(FormulaPosition(action, 'BEFORE') for action in ACTIONS)
    assert step.withdraw == (before if stop else ())
    assert step.start == ()


def test_a_verdict_is_final() -> None:
    execution, _ = begun(PLAN)
    execution.conclude(WHOLE)
    execution.conclude(WHOLE, failed=True)
    assert execution.phase(WHOLE) is PlanPhase.DECIDED
    assert WHOLE not in execution.end().withdraw
    assert execution.phase(WHOLE) is PlanPhase.DECIDED


@pytest.mark.parametrize('stop', [False, True])
def test_a_withdrawn_formula_may_have_a_verdict_from_a_late_state(*, stop: bool) -> None:
    execution, _ = begun(Plan('p', PLAN.actions, PLAN.formulas, stop_at_violation=stop))
    before = FormulaPosition('land', 'BEFORE')
    assert before in execution.report('land', Event.STARTED).withdraw
    step = execution.conclude(before, violated=True)
    assert execution.phase(before) is PlanPhase.DECIDED
    assert execution.has_ended == stop
    assert (WHOLE in step.withdraw) == stop


@pytest.mark.parametrize(
    ('action', 'event', 'code', 'words'),
    [
        ('hover', Event.STARTED, ExitCode.NOT_FOUND, 'it has: take_off, fly_to, land'),
        ('land', Event.SUCCEEDED, ExitCode.INVALID_ARGUMENT,
         'it has not started; report that it has started or failed'),
        ('take_off', Event.STARTED, ExitCode.INVALID_ARGUMENT,
         'it is being executed; report that it has succeeded or failed'),
        ('fly_to', Event.FAILED, ExitCode.INVALID_ARGUMENT, 'it has succeeded already'),
    ],
)  # fmt: skip
def test_a_report_that_makes_no_sense_says_what_does(
    action: str, event: Event, code: ExitCode, words: str
) -> None:
    execution, _ = begun(PLAN)
    execution.report('take_off', Event.STARTED)
    execution.report('fly_to', Event.STARTED)
    execution.report('fly_to', Event.SUCCEEDED)
    with pytest.raises(CoordinationError, match=words) as caught:
        execution.report(action, event)
    assert caught.value.code is code


def test_nothing_is_reported_of_a_plan_that_is_over() -> None:
    execution, _ = begun(PLAN)
    execution.end()
    with pytest.raises(CoordinationError, match="plan 'mission' is over"):
        execution.report('take_off', Event.STARTED)


@pytest.mark.parametrize(
    ('plan', 'words'),
    [
        (Plan('', PLAN.actions), 'no name'),
        (Plan('p', ()), 'no actions'),
        (Plan('p', (PlanAction('a'), PlanAction('a'))), "called 'a'; names must differ"),
        (Plan('p', (PlanAction(''),)), "one action of plan 'p' has no name"),
        (Plan('p', (PlanAction('a', EACH[:1] * 2),)), "another formula of action 'a' is called"),
        (Plan('p', (PlanAction('a'),), EACH[:1] * 2), "another formula of plan 'p' is called"),
    ],
)
def test_a_plan_that_makes_no_sense(plan: Plan, words: str) -> None:
    with pytest.raises(CoordinationError, match=words):
        PlanExecution(plan)


@pytest.mark.parametrize(
    ('states', 'presumably_false', 'explanation', 'outcome'),
    [
        (0, False, 'no state of its period had come', 'withdrawn'),
        (1, False, 'held in 1 state', 'withdrawn (held)'),
        (37, False, 'held in 37 states', 'withdrawn (held)'),
        (37, True, 'not fulfilled after 37 states', 'withdrawn (not fulfilled)'),
    ],
)
def test_how_a_formula_stood_when_it_was_withdrawn(
    states: int, explanation: str, outcome: str, *, presumably_false: bool
) -> None:
    assert withdrawal(states, presumably_false=presumably_false) == explanation
    verdict = PlanVerdict(
        FormulaPosition('fly', 'calm'),
        'always p',
        PlanPhase.WITHDRAWN,
        presumably_false=presumably_false,
        explanation=explanation,
    )
    assert verdict.outcome == outcome


def test_what_is_not_known_of_a_withdrawn_formula() -> None:
    text = withdrawal(0, presumably_false=False, unknown=5, waited_for='/a is silent')
    assert text == 'no state of its period had come; it waited for states: /a is silent'
    verdict = PlanVerdict(WHOLE, 'always p', PlanPhase.WITHDRAWN, explanation=text)
    assert verdict.outcome == 'withdrawn'
    text = withdrawal(2, presumably_false=False, unknown=1_040_000_000, waited_for='/a is silent')
    assert text == (
        'held in 2 states; not evaluated in the last 1.04 s; it waited for states: /a is silent'
    )
    assert replace(verdict, explanation=text).outcome == 'withdrawn (held)'


def test_the_words_for_other_phases() -> None:
    pending = PlanVerdict(FormulaPosition('fly', 'calm'), 'always p')
    assert pending.outcome == 'pending'
    assert replace(pending, phase=PlanPhase.FAILED).outcome == 'failed'
    assert replace(pending, phase=PlanPhase.DECIDED, verdict=Verdict.FALSE).outcome == 'false'
