"""Plans whose execution is monitored: which formulas are evaluated after which report.

A plan is a set of actions, in whatever order they turn out to be executed, and formulas that must
hold around them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_coordinator.errors import CoordinationError


class Holds(IntEnum):
    """When a formula of an action must hold; the numbers are those of PlanFormula."""

    WHILE_EXECUTING = 0
    """From the start of its action to the end of the action."""
    BEFORE = 1
    """From the start of the plan to the start of its action."""
    AFTER = 2
    """From the success of its action to the end of the plan."""
    FROM_START = 3
    """From the start of its action to the end of the plan, unless the action fails."""


class Event(IntEnum):
    """What is reported of an action; the numbers are those of ReportPlanAction."""

    STARTED = 0
    SUCCEEDED = 1
    FAILED = 2


class PlanPhase(IntEnum):
    """Where a formula of a plan is; the numbers are those of PlanVerdict."""

    PENDING = 0
    RUNNING = 1
    DECIDED = 2
    WITHDRAWN = 3
    FAILED = 4


class _State(Enum):
    PENDING = 'has not started'
    EXECUTING = 'is being executed'
    SUCCEEDED = 'has succeeded'
    FAILED = 'has failed'


@dataclass(frozen=True, slots=True)
class PlanFormula:
    """A formula that monitors the execution of a plan.

    Args:
        name: unique among those of its action, or of the whole plan.
        holds: when; without a meaning for a formula of the whole plan.
    """

    name: str
    formula: str
    holds: Holds = Holds.WHILE_EXECUTING


@dataclass(frozen=True, slots=True)
class PlanAction:
    """An action of a plan, and the formulas that must hold around it."""

    name: str
    formulas: tuple[PlanFormula, ...] = ()


@dataclass(frozen=True, slots=True)
class FormulaPosition:
    """Where a formula stands in its plan.

    Args:
        action: the name of its action; empty for a formula of the whole plan.
        formula: the name of the formula.
    """

    action: str
    formula: str


@dataclass(frozen=True, slots=True)
class Plan:
    """Actions, and formulas that must hold around them.

    Args:
        formulas: hold from the start of the plan to its end.
        stop_at_violation: end as soon as a formula is false or cannot be evaluated.
    """

    name: str
    actions: tuple[PlanAction, ...]
    formulas: tuple[PlanFormula, ...] = ()
    stop_at_violation: bool = False

    @property
    def places(self) -> dict[FormulaPosition, PlanFormula]:
        """All formulas, those of the whole plan first.

        Raises:
            CoordinationError: when the plan makes no sense; names what is at fault.
        """
        if not self.name:
            raise CoordinationError('the plan has no name; reports of its actions need one')
        if not self.actions:
            raise CoordinationError(
                f"plan '{self.name}' has no actions, so it would be over at once; for formulas "
                'alone there is MonitorFormula'
            )
        _require_distinct((each.name for each in self.actions), f"action of plan '{self.name}'")
        of_plan = _places('', self.formulas, f"formula of plan '{self.name}'")
        of_actions = [
            _places(action.name, action.formulas, f"formula of action '{action.name}'")
            for action in self.actions
        ]
        return {place: formula for each in (of_plan, *of_actions) for place, formula in each}


@dataclass(frozen=True, slots=True)
class PlanVerdict:
    """What is known of a formula of a plan.

    Args:
        formula: its canonical text, once that is known.
        presumably_false: of one that was withdrawn: it would have been false then.
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict.
        explanation: for people: what decided it.
        error: why it cannot be evaluated.
    """

    place: FormulaPosition
    formula: str
    phase: PlanPhase = PlanPhase.PENDING
    verdict: Verdict = Verdict.UNDECIDED
    presumably_false: bool = False
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None

    @property
    def is_violation(self) -> bool:
        """Whether the formula is false or cannot be evaluated."""
        return self.verdict is Verdict.FALSE or self.error is not None


@dataclass(frozen=True, slots=True)
class PlanOutcome:
    """How the monitoring of a plan ended.

    Args:
        verdicts: of all formulas.
        error: why it was not monitored to its end.
    """

    verdicts: tuple[PlanVerdict, ...] = ()
    error: DyKnowError | None = None

    @property
    def violations(self) -> tuple[PlanVerdict, ...]:
        """Formulas that are false or could not be evaluated."""
        return tuple(verdict for verdict in self.verdicts if verdict.is_violation)


@dataclass(frozen=True, slots=True)
class Step:
    """What to do next: first withdraw formulas, then start others."""

    withdraw: tuple[FormulaPosition, ...] = ()
    start: tuple[FormulaPosition, ...] = ()


_STARTS: Final = {
    Event.STARTED: {Holds.WHILE_EXECUTING, Holds.FROM_START},
    Event.SUCCEEDED: {Holds.AFTER},
    Event.FAILED: set(),
}
_ENDS: Final = {
    Event.STARTED: {Holds.BEFORE},
    Event.SUCCEEDED: {Holds.WHILE_EXECUTING},
    Event.FAILED: {Holds.BEFORE, Holds.WHILE_EXECUTING, Holds.FROM_START},
}
_NEXT: Final = {
    (_State.PENDING, Event.STARTED): _State.EXECUTING,
    # It is given up before it was begun: only so can a plan end that goes no further.
    (_State.PENDING, Event.FAILED): _State.FAILED,
    (_State.EXECUTING, Event.SUCCEEDED): _State.SUCCEEDED,
    (_State.EXECUTING, Event.FAILED): _State.FAILED,
}


class PlanExecution:
    """How far the execution of a plan is, and the phase of each of its formulas.

    A formula whose time never came stays PENDING to the end.

    Raises:
        CoordinationError: when the plan makes no sense; names what is at fault.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.ended = False
        self._formulas = plan.places
        self._phases = dict.fromkeys(self._formulas, PlanPhase.PENDING)
        self._actions = {action.name: _State.PENDING for action in plan.actions}

    def phase(self, place: FormulaPosition) -> PlanPhase:
        """Where a formula is."""
        return self._phases[place]

    def begin(self) -> Step:
        """The plan starts."""
        first = (
            place
            for place, formula in self._formulas.items()
            if not place.action or formula.holds is Holds.BEFORE
        )
        return Step(start=self._move(first, PlanPhase.PENDING, PlanPhase.RUNNING))

    def report(self, action: str, event: Event) -> Step:
        """An action has started, succeeded or failed.

        Raises:
            CoordinationError: when that cannot be; says what can.
        """
        if action not in self._actions:
            raise CoordinationError(
                f"plan '{self.plan.name}' has no action '{action}' "
                f'(it has: {", ".join(self._actions)})',
                ExitCode.NOT_FOUND,
            )
        state = self._actions[action]
        following = _NEXT.get((state, event))
        if following is None or self.ended:
            raise CoordinationError(self._refusal(action, state, event))
        self._actions[action] = following
        if not {_State.PENDING, _State.EXECUTING} & set(self._actions.values()):
            return self.end()
        over, due = self._around(action, _ENDS[event]), self._around(action, _STARTS[event])
        return Step(
            withdraw=self._move(over, PlanPhase.RUNNING, PlanPhase.WITHDRAWN),
            start=self._move(due, PlanPhase.PENDING, PlanPhase.RUNNING),
        )

    def settle(
        self, place: FormulaPosition, *, failed: bool = False, violated: bool = False
    ) -> Step:
        """A running formula has a verdict, or cannot be evaluated.

        Args:
            place: of the formula.
            failed: it cannot be evaluated.
            violated: its verdict is false.
        """
        if self._phases[place] is not PlanPhase.RUNNING:
            return Step()
        self._phases[place] = PlanPhase.FAILED if failed else PlanPhase.DECIDED
        return self.end() if self.plan.stop_at_violation and (failed or violated) else Step()

    def end(self) -> Step:
        """The plan is over: nothing runs any more."""
        self.ended = True
        return Step(withdraw=self._move(self._formulas, PlanPhase.RUNNING, PlanPhase.WITHDRAWN))

    def _around(self, action: str, holds: set[Holds]) -> Iterable[FormulaPosition]:
        return (
            place
            for place, formula in self._formulas.items()
            if place.action == action and formula.holds in holds
        )

    def _move(
        self, places: Iterable[FormulaPosition], before: PlanPhase, after: PlanPhase
    ) -> tuple[FormulaPosition, ...]:
        moved = tuple(place for place in places if self._phases[place] is before)
        self._phases.update(dict.fromkeys(moved, after))
        return moved

    def _refusal(self, action: str, state: _State, event: Event) -> str:
        reported = f"'{action}' cannot have {_done(event)}: "
        if self.ended:
            return f"{reported}plan '{self.plan.name}' is over"
        possible = [_done(each) for before, each in _NEXT if before is state]
        if not possible:
            return f'{reported}it {state.value} already, and that is its end'
        return f'{reported}it {state.value}; report that it has {" or ".join(possible)}'


def _done(event: Event) -> str:
    return event.name.lower()


def _places(
    action: str, formulas: tuple[PlanFormula, ...], what: str
) -> list[tuple[FormulaPosition, PlanFormula]]:
    _require_distinct((formula.name for formula in formulas), what)
    return [(FormulaPosition(action, formula.name), formula) for formula in formulas]


def _require_distinct(names: Iterable[str], what: str) -> None:
    seen: set[str] = set()
    for name in names:
        if not name:
            raise CoordinationError(f'one {what} has no name; give it one')
        if name in seen:
            raise CoordinationError(f"another {what} is called '{name}'; names must differ")
        seen.add(name)
