"""The formulas of a guard, as receivers of their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from dyknow_common import Value
from dyknow_reactions.guard.command_formulas import CommandFormula
from dyknow_reactions.guard.gate import Gate
from dyknow_reactions.guard.watched_formula import WatchedFormula

Settle = Callable[[int], None]
"""Called with the monotonic time after each change of the gate, in nanoseconds."""


class GuardClock(NamedTuple):
    """The clocks of a guard, in nanoseconds.

    Args:
        now: returns the monotonic time.
        age: returns the time that has passed since a valid time, at least 0.
    """

    now: Callable[[], int]
    age: Callable[[int], int]


class WatchedStates:
    """A formula that must hold at every state.

    Args:
        name: of the formula in the gate.
        gate: is informed of each state.
        settle: called afterwards.
        clock: of the guard.
    """

    def __init__(self, name: str, gate: Gate, clock: GuardClock, settle: Settle) -> None:
        self._name, self._gate, self._clock, self._settle = name, gate, clock, settle
        self._formula: WatchedFormula | None = None

    def begin(self, formula: str, domains: Mapping[str, Sequence[str]]) -> None:
        """Begin with the states of another stream."""
        self._formula = WatchedFormula(formula, domains)

    def receive(self, valid_time: int, values: Mapping[str, Value], *, is_after_gap: bool) -> None:
        """Ask the formula at a state."""
        if self._formula is None:
            return
        if is_after_gap:
            self._formula.gap()
        failure = self._formula.failure(valid_time, values)
        now = self._clock.now()
        self._gate.note_state(self._name, now, failure, age=self._clock.age(valid_time))
        self._settle(now)

    def fail(self, reason: str) -> None:
        """Close the gate."""
        now = self._clock.now()
        self._gate.note_fault(self._name, now, reason)
        self._settle(now)


class CommandStates:
    """A formula over commands and states; arguments as in `WatchedStates`."""

    def __init__(
        self, name: str, formula: CommandFormula, gate: Gate, clock: GuardClock, settle: Settle
    ) -> None:
        self._name, self._formula, self._gate = name, formula, gate
        self._clock, self._settle = clock, settle

    def begin(self, _formula: str, domains: Mapping[str, Sequence[str]]) -> None:
        """Begin with other states; the history of commands begins anew."""
        self._formula.begin(domains)

    def receive(self, valid_time: int, values: Mapping[str, Value], *, is_after_gap: bool) -> None:  # noqa: ARG002
        """Keep the values of a state."""
        self._formula.set_state(values)
        now = self._clock.now()
        self._gate.note_state(self._name, now, age=self._clock.age(valid_time))
        self._settle(now)

    def fail(self, reason: str) -> None:
        """Close the gate."""
        now = self._clock.now()
        self._gate.note_fault(self._name, now, reason)
        self._settle(now)


class CommandFormulas:
    """The formulas that a guard tries at each command."""

    def __init__(self, formulas: Mapping[str, CommandFormula]) -> None:
        self._formulas = dict(formulas)
        self._latest = 0
        for each in self._formulas.values():
            if not each.state_formula and not each.sorts:
                each.begin({})

    def __bool__(self) -> bool:
        return bool(self._formulas)

    @property
    def paths(self) -> frozenset[str]:
        """The paths in a command that are read."""
        return frozenset(path for each in self._formulas.values() for path in each.fields.values())

    def refusal(self, command: Mapping[str, Value], now: int) -> str:
        """Return why a command must not pass; if it may, it is part of the history.

        Args:
            command: the values by their paths.
            now: the monotonic time, in nanoseconds.
        """
        self._latest = max(now, self._latest + 1)
        for name, each in self._formulas.items():
            values = {key: command[path] for key, path in each.fields.items() if path in command}
            if reason := each.refusal(self._latest, values):
                return f'{name}: {reason}'
        for each in self._formulas.values():
            each.accept()
        return ''
