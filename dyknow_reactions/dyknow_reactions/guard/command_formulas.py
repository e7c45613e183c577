"""Formulas over the messages of a guard (commands): commands that would violate them do not pass.

For the input /cmd_vel_in, the formula

    forall r in Rover: "/cmd_vel_in".linear.x > 0.5 -> Ahead[r] > 1 m

is tried at each command, with the fields of the command and the latest values of `Ahead`. These
come with the states of another formula, which is about the same features and is never decided:

    forall r in Rover: (always[500000 h, 500000 h] (Ahead[r] = Ahead[r]))
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from dyknow_common import SymbolKind, Value, quoted
from dyknow_reactions.guard.gate import GateReports
from dyknow_reasoning import (
    Domains,
    Feature,
    FieldReference,
    Formula,
    Kind,
    Quantifier,
    ReasoningError,
    Term,
    TrialFormula,
    UnknownFeatures,
    Variable,
    check_trial,
    check_types,
    parts,
    symbols_of,
    walk,
)

_NEVER = 'always[500000 h, 500000 h]'
"""In 57 years, about the longest time that messages can hold; `always` is presumably true."""


class CommandFormula:
    """A formula over commands and states.

    Args:
        text: the formula.
        topic: the topic of the commands, as the formula names it.
        units: the units of features, by name.

    Raises:
        LanguageError: if it cannot be tried at single states.
    """

    def __init__(self, text: str, topic: str, units: Mapping[str, str]) -> None:
        formula = check_trial(text)
        named = {each.name for each in walk(formula) if isinstance(each, Feature)}
        stated = ', '.join(f'{name}: {quoted(units[name])}' for name in sorted(named & {*units}))
        self._text = f'let {stated} in ({text})' if stated else text
        references = [each for each in walk(formula) if isinstance(each, FieldReference)]
        self.fields = {str(each): each.path for each in references if each.stream == topic}
        """The paths in the command, by the names of their values."""
        self.sorts = [each.name for each in symbols_of(formula) if each.kind is SymbolKind.SORT]
        self.state_formula = _state_formula(formula, self.fields, text)
        """A formula over the same features, for the states; empty if it needs none."""
        self._trial: TrialFormula | None = None
        self._states: Mapping[str, Value] = {}

    def begin(self, domains: Domains) -> None:
        """Fix the objects of each sort, and begin with an empty history.

        Raises:
            DyKnowError: for a sort without a domain, or a formula that is too large.
        """
        self._trial = TrialFormula(self._text, domains)
        self._states = {}

    def set_state(self, values: Mapping[str, Value]) -> None:
        """Set the latest values of the other features."""
        self._states = values

    def refusal(self, time: int, command: Mapping[str, Value]) -> str:
        """Return why a command must not pass; empty if it may.

        Args:
            time: the time by the monotonic clock, after the latest command that passed.
            command: the values of `fields`.
        """
        if self._trial is None:
            return 'the objects of its sorts are not known yet'
        try:
            if self._trial.holds(time, {**self._states, **command}):
                return ''
        except ReasoningError as error:
            return str(error)
        return ', '.join(f'{name} is {value}' for name, value in command.items())

    def accept(self) -> None:
        """Add the command to the history, as it passes."""
        if self._trial is not None:
            self._trial.accept()


class CommandStates:
    """The receiver of the states of a formula over commands and states; see `StateReceiver`.

    Args:
        name: the name of the formula in the gate.
        formula: the formula.
        reports: the gate, which gets a report on each state.
    """

    def __init__(self, name: str, formula: CommandFormula, reports: GateReports) -> None:
        self._name, self._formula, self._reports = name, formula, reports
        self.crosses_gaps = False

    def begin(
        self, _formula: str, domains: Mapping[str, Sequence[str]], _unknown: UnknownFeatures
    ) -> None:
        """Begin with other states; the history of commands begins anew.

        A value that is unknown refuses a command.
        """
        self._formula.begin(domains)

    def gap(self) -> None:
        """Do nothing: only the latest state counts."""

    def receive(self, valid_time: int, values: Mapping[str, Value]) -> None:
        """Keep the values of a state."""
        self._formula.set_state(values)
        self._reports.state(self._name, valid_time)

    def fail(self, reason: str) -> None:
        """Close the gate."""
        self._reports.fault(self._name, reason)


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


def _state_formula(formula: Formula, commanded: Mapping[str, str], text: str) -> str:
    kinds = check_types(formula, text)
    found: dict[str, None] = {}
    for prefix, field in _fields(formula, {}):
        if str(field) in commanded:
            continue
        name = field.name if isinstance(field, Feature) else str(field)
        atom = str(field) if kinds.get(name) is Kind.BOOLEAN else f'{field} = {field}'
        found[f'({prefix}({_NEVER} ({atom})))'] = None
    return ' and '.join(found)


def _fields(
    node: Formula | Term, sorts: Mapping[str, str]
) -> Iterator[tuple[str, Feature | FieldReference]]:
    """Yield the fields of a formula, each with the quantifiers of its variables."""
    if isinstance(node, Feature | FieldReference):
        variables = dict.fromkeys(
            each.name
            for each in (node.arguments if isinstance(node, Feature) else ())
            if isinstance(each, Variable)
        )
        yield ''.join(f'forall {name} in {sorts[name]}: ' for name in variables), node
    if isinstance(node, Quantifier):
        sorts = {**sorts, node.variable: node.sort}
    for part in parts(node):
        yield from _fields(part, sorts)
