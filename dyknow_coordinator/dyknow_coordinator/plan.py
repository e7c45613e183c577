"""Plans whose execution is monitored: which formulas are evaluated after which reports.

A plan is a set of actions, executed in any order, and formulas that must hold around them. Example:
a plan with a formula `p`, an action `fly` with three formulas (`b` BEFORE, `w` WHILE_EXECUTING and
`a` AFTER), and an action `land`. The formulas are evaluated in these periods:

    report        begin     fly started   fly succeeded   land started   land succeeded
    p               |---------------------------------------------------------|
    b               |------------|
    w                            |-------------|
    a                                          |------------------------------|

So `begin()` starts `p` and `b`; `report('fly', STARTED)` withdraws `b` and starts `w`. A formula
with a verdict is not withdrawn. States come later than they are valid, so a withdrawn formula may
still get a verdict, from a state of its period. The plan ends when all actions have succeeded or
failed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from dyknow_common import DyKnowError, ExitCode, Verdict, listed, round_duration
from dyknow_coordinator.errors import CoordinationError


class Holds(IntEnum):
    """Period in which a formula of an action must hold; numbers as in PlanFormula."""

    WHILE_EXECUTING = 0
    """From the start of its action to the end of the action."""
    BEFORE = 1
    """From the start of the plan to the start of its action."""
    AFTER = 2
    """From the success of its action to the end of the plan."""
    FROM_START = 3
    """From the start of its action to the end of the plan, unless the action fails."""


class Event(IntEnum):
    """Report on an action; numbers as in ReportPlanAction."""

    STARTED = 0
    SUCCEEDED = 1
    FAILED = 2


class PlanPhase(IntEnum):
    """Phase of a formula of a plan; numbers as in PlanVerdict."""

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
        name: unique among the formulas of its action, or of the whole plan.
        holds: when it must hold; ignored for a formula of the whole plan.
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
    """Position of a formula in its plan.

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
        name: unique among the plans that are monitored.
        actions: at least one.
        formulas: hold from the start of the plan to its end.
        stop_at_violation: end as soon as a formula is false or cannot be evaluated.
    """

    name: str
    actions: tuple[PlanAction, ...]
    formulas: tuple[PlanFormula, ...] = ()
    stop_at_violation: bool = False

    @property
    def formulas_by_position(self) -> dict[FormulaPosition, PlanFormula]:
        """All formulas; the formulas of the whole plan come first.

        Raises:
            CoordinationError: if the plan is invalid; names the part at fault.
        """
        if not self.name:
            raise CoordinationError('the plan has no name; reports of its actions need one')
        if not self.actions:
            raise CoordinationError(
                f"plan '{self.name}' has no actions, so it would end at once; for formulas "
                'without actions use MonitorFormula'
            )
        _require_distinct((each.name for each in self.actions), f"action of plan '{self.name}'")
        _require_distinct((each.name for each in self.formulas), f"formula of plan '{self.name}'")
        found = {FormulaPosition('', each.name): each for each in self.formulas}
        for action in self.actions:
            names = (each.name for each in action.formulas)
            _require_distinct(names, f"formula of action '{action.name}'")
            found |= {FormulaPosition(action.name, each.name): each for each in action.formulas}
        return found


def _require_distinct(names: Iterable[str], kind: str) -> None:
    seen: set[str] = set()
    for name in names:
        if not name:
            raise CoordinationError(f'one {kind} has no name; give it one')
        if name in seen:
            raise CoordinationError(f"another {kind} is called '{name}'; names must differ")
        seen.add(name)


NO_STATE: Final = 'no state of its period had come'
"""The explanation of a formula that was withdrawn before its first state."""


def withdrawal(
    states: int, *, presumably_false: bool, unknown: int | None = None, waited_for: str = ''
) -> str:
    """Return how a formula stood when it was withdrawn, for people.

    Args:
        states: the number of states over which it was evaluated.
        presumably_false: it would have been false without further states.
        unknown: the last part of its period over which it was not evaluated, in nanoseconds; None
            if it was evaluated to the end.
        waited_for: why no state came for a while; empty if states came.
    """
    counted = f'{states} state{"s" if states > 1 else ""}'
    text = f'not fulfilled after {counted}' if presumably_false else f'held in {counted}'
    parts = (
        text if states else NO_STATE,
        f'not evaluated in the last {round_duration(unknown)}' if states and unknown else '',
        f'it waited for states: {waited_for}' if waited_for else '',
    )
    return '; '.join(filter(None, parts))


@dataclass(frozen=True, slots=True)
class PlanVerdict:
    """Status of a formula of a plan.

    Args:
        formula: its canonical text; the text as requested until that is known.
        presumably_false: True if the formula was withdrawn and would have been false then.
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict, or
            if the verdict needs no state.
        explanation: the reason for the verdict, how it stood when it was withdrawn, or what it
            waits for while it runs, for people.
        error: why it cannot be evaluated.
    """

    position: FormulaPosition
    formula: str
    phase: PlanPhase = PlanPhase.PENDING
    verdict: Verdict = Verdict.UNDECIDED
    presumably_false: bool = False
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None

    @property
    def outcome(self) -> str:
        """The verdict, or the phase, in a word: `true`, `pending`, `withdrawn (held)`."""
        if self.verdict is not Verdict.UNDECIDED:
            return self.verdict.name.lower()
        if self.phase is PlanPhase.WITHDRAWN and self.presumably_false:
            return 'withdrawn (not fulfilled)'
        has_states = bool(self.explanation) and not self.explanation.startswith(NO_STATE)
        if self.phase is PlanPhase.WITHDRAWN and has_states:
            return 'withdrawn (held)'
        return self.phase.name.lower()

    @property
    def is_violation(self) -> bool:
        """True if the formula is false or cannot be evaluated."""
        return self.verdict is Verdict.FALSE or self.error is not None


@dataclass(frozen=True, slots=True)
class PlanOutcome:
    """Outcome of the monitoring of a plan.

    Args:
        verdicts: the verdicts of all formulas.
        error: why the plan was not monitored to its end.
    """

    verdicts: tuple[PlanVerdict, ...] = ()
    error: DyKnowError | None = None

    @property
    def violations(self) -> tuple[PlanVerdict, ...]:
        """Formulas that are false or could not be evaluated."""
        return tuple(verdict for verdict in self.verdicts if verdict.is_violation)


@dataclass(frozen=True, slots=True)
class Step:
    """Next step of an execution: formulas to withdraw, then formulas to start."""

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
_TRANSITIONS: Final = {
    (_State.PENDING, Event.STARTED): _State.EXECUTING,
    # An action that will not be started has failed: a plan that is given up can end.
    (_State.PENDING, Event.FAILED): _State.FAILED,
    (_State.EXECUTING, Event.SUCCEEDED): _State.SUCCEEDED,
    (_State.EXECUTING, Event.FAILED): _State.FAILED,
}


class PlanExecution:
    """States of the actions of a plan, and the phase of each of its formulas.

    A formula whose period does not begin stays PENDING to the end.

    Raises:
        CoordinationError: if the plan is invalid; names the part at fault.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.has_ended = False
        self._formulas = plan.formulas_by_position
        self._phases = dict.fromkeys(self._formulas, PlanPhase.PENDING)
        self._actions = {action.name: _State.PENDING for action in plan.actions}

    def phase(self, position: FormulaPosition) -> PlanPhase:
        """Return the phase of a formula."""
        return self._phases[position]

    def begin(self) -> Step:
        """Start the plan."""
        first = (
            position
            for position, formula in self._formulas.items()
            if not position.action or formula.holds is Holds.BEFORE
        )
        return Step(start=self._set_phases(first, PlanPhase.PENDING, PlanPhase.RUNNING))

    def report(self, action: str, event: Event) -> Step:
        """Apply a report on an action.

        Raises:
            CoordinationError: if the report is impossible; names the possible ones.
        """
        if action not in self._actions:
            raise CoordinationError(
                f"plan '{self.plan.name}' has no action '{action}' "
                f'(it has: {listed(self._actions)})',
                ExitCode.NOT_FOUND,
            )
        following = _TRANSITIONS.get((self._actions[action], event))
        if following is None or self.has_ended:
            raise CoordinationError(self._refusal(action, event))
        self._actions[action] = following
        if not {_State.PENDING, _State.EXECUTING} & set(self._actions.values()):
            return self.end()
        over, due = self._positions(action, _ENDS[event]), self._positions(action, _STARTS[event])
        return Step(
            withdraw=self._set_phases(over, PlanPhase.RUNNING, PlanPhase.WITHDRAWN),
            start=self._set_phases(due, PlanPhase.PENDING, PlanPhase.RUNNING),
        )

    def conclude(
        self, position: FormulaPosition, *, failed: bool = False, violated: bool = False
    ) -> Step:
        """Record that a formula has a verdict, or cannot be evaluated.

        A withdrawn formula may have a verdict, too, from a late state of its period.

        Args:
            position: the position of the formula.
            failed: it cannot be evaluated.
            violated: its verdict is false.
        """
        if self._phases[position] not in {PlanPhase.RUNNING, PlanPhase.WITHDRAWN}:
            return Step()
        self._phases[position] = PlanPhase.FAILED if failed else PlanPhase.DECIDED
        return self.end() if self.plan.stop_at_violation and (failed or violated) else Step()

    def end(self) -> Step:
        """End the plan, and withdraw all running formulas."""
        self.has_ended = True
        return Step(
            withdraw=self._set_phases(self._formulas, PlanPhase.RUNNING, PlanPhase.WITHDRAWN)
        )

    def _positions(self, action: str, holds: set[Holds]) -> Iterator[FormulaPosition]:
        return (
            position
            for position, formula in self._formulas.items()
            if position.action == action and formula.holds in holds
        )

    def _set_phases(
        self, positions: Iterable[FormulaPosition], before: PlanPhase, after: PlanPhase
    ) -> tuple[FormulaPosition, ...]:
        """Change the phase of the formulas that are in the phase `before`; return them."""
        changed = tuple(position for position in positions if self._phases[position] is before)
        self._phases.update(dict.fromkeys(changed, after))
        return changed

    def _refusal(self, action: str, event: Event) -> str:
        """Return why a report is impossible."""
        state = self._actions[action]
        refused = f"'{action}' cannot have {event.name.lower()}: "
        if self.has_ended:
            return f"{refused}plan '{self.plan.name}' is over"
        possible = [each.name.lower() for before, each in _TRANSITIONS if before is state]
        if not possible:
            return f'{refused}it {state.value} already, which is final'
        return f'{refused}it {state.value}; report that it has {" or ".join(possible)}'
