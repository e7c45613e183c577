"""Formula groups: formulas over one stream of states and one domain for each sort (VI-A.6)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from dyknow_reasoning.bounds import Chronology
from dyknow_reasoning.columns import recorded
from dyknow_reasoning.ensemble import Ensemble, Outcome
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.explanation import explain
from dyknow_reasoning.grounding import ground
from dyknow_reasoning.node_store import NodeStore
from dyknow_reasoning.nodes import FALSE, Constant
from dyknow_reasoning.parsing import parse_formula
from dyknow_reasoning.recording import values_at
from dyknow_reasoning.residual import remaining_text
from dyknow_reasoning.results import FormulaResult, Verdict
from dyknow_reasoning.shapes import Member
from dyknow_reasoning.symbols import Symbol, ground_symbols, symbols_of
from dyknow_reasoning.type_checking import Kinds, check_types
from dyknow_stream_processing import ExitCode, format_time, round_time

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from dyknow_reasoning.atoms import Values
    from dyknow_reasoning.columns import Array, Recording
    from dyknow_reasoning.formula import Formula
    from dyknow_reasoning.grounding import Domains, Instance

DEFAULT_NODE_LIMIT = 100_000
_WHATEVER = {
    Verdict.TRUE: 'true for these objects, whatever the states are',
    Verdict.FALSE: 'false for these objects, whatever the states are',
}


@dataclass(frozen=True, slots=True)
class NamedFormula:
    """A formula of a group; its `str` is the canonical text.

    Args:
        name: what the user calls it.
        formula: its abstract syntax.
        kinds: the kinds of its features.
    """

    name: str
    formula: Formula
    kinds: Kinds

    def __str__(self) -> str:
        return str(self.formula)


class FormulaGroup:
    """Formulas that are progressed over the same states, each until it is decided.

    Add the formulas, `begin` with the domains, then `progress` state by state.

    Args:
        node_limit: a formula that grows to more nodes by progression fails.
    """

    def __init__(self, node_limit: int = DEFAULT_NODE_LIMIT) -> None:
        self._node_limit = node_limit
        self._formulas: dict[int, NamedFormula] = {}
        self._instances: dict[int, list[Instance]] = {}
        # The formulas that need no state, until that has been told.
        self._known: dict[int, Verdict] = {}
        self._ends: dict[int, str] = {}
        self._undecided: set[int] = set()
        self._ensemble: Ensemble | None = None
        self._latest: int | None = None

    @property
    def formulas(self) -> Mapping[int, NamedFormula]:
        """The formulas by their ids."""
        return self._formulas

    def add_formula(self, name: str, text: str) -> int:
        """Adds a formula and returns its id.

        Raises:
            LanguageError: for a text that is no formula, or makes no sense; with the place.
            ReasoningError: once the group has begun.
        """
        if self._ensemble:
            raise ReasoningError(
                f"the formula group has begun; add '{name}' to a new group", ExitCode.ALREADY_EXISTS
            )
        formula = parse_formula(text)
        formula_id = len(self._formulas) + 1
        self._formulas[formula_id] = NamedFormula(name, formula, check_types(formula, text))
        return formula_id

    def symbols(self) -> list[Symbol]:
        """The symbols of all formulas, each once.

        Before `begin` they are those of the texts; the argument of a feature is an object, or the
        sort that the variable there ranges over. After it they are the ground features that the
        formulas depend on once simplified: the fields that each state must hold.
        """
        if self._ensemble:
            return ground_symbols(chain.from_iterable(self._instances.values()))
        found = (symbol for each in self._formulas.values() for symbol in symbols_of(each.formula))
        return list(dict.fromkeys(found))

    def begin(self, domains: Domains) -> None:
        """Fixes the objects of each sort, in the order given.

        Raises:
            ReasoningError: for a sort without a domain, or when the group has begun before.
        """
        if self._ensemble:
            raise ReasoningError('the formula group has begun already', ExitCode.ALREADY_EXISTS)
        store = NodeStore(Chronology())
        self._instances = {
            formula_id: ground(each.formula, domains, store)
            for formula_id, each in self._formulas.items()
        }
        verdicts = {each: _verdict(instances) for each, instances in self._instances.items()}
        self._known = {each: verdict for each, verdict in verdicts.items() if verdict}
        self._undecided = set(self._formulas)
        self._ensemble = Ensemble(list(self._members()), self._node_limit)

    def decided_at_once(self) -> list[FormulaResult]:
        """The results of the formulas that are decided whatever the states are.

        Who does not ask gets them with the first state.
        """
        self._begun()
        return self._decide_at_once(None)

    def progress(self, valid_time: int, values: Values) -> list[FormulaResult]:
        """Progresses all undecided formulas over a state; returns the results that it brings.

        A formula fails, and the others go on, when the state lacks a field that the formula still
        depends on or holds a value there that it cannot use.

        Args:
            valid_time: of the state, in nanoseconds; later than that of the state before.
            values: a value for each ground feature, by the name `Symbol.field`.

        Raises:
            ReasoningError: before `begin`.
        """
        latest = self._latest
        if self._ensemble is None or latest is None:
            return self._progress_first(valid_time, values)
        if valid_time <= latest:
            return self.fail(_not_later(valid_time, latest), valid_time)
        self._latest = valid_time
        elapsed = valid_time - latest
        routine = self._ensemble.routine
        if routine and elapsed == routine.elapsed and routine.step(values):
            return []
        outcome = self._ensemble.progress(valid_time, elapsed, values)
        return self._take(outcome, valid_time, values) if outcome else []

    def progress_many(
        self, valid_times: Iterable[int], columns: Mapping[str, Iterable[Any]]
    ) -> list[FormulaResult]:
        """Progresses all undecided formulas over many states.

        Args:
            valid_times: of the states, in nanoseconds; may be an array of numpy.
            columns: for each ground feature its values, one for each state; may be arrays of numpy.

        Raises:
            ReasoningError: for columns of different lengths, or before `begin`.
        """
        ensemble = self._begun()
        times = np.array(valid_times if isinstance(valid_times, np.ndarray) else list(valid_times))
        recording = recorded(columns)
        for name, column in recording.items():
            if len(column) != len(times):
                raise ReasoningError(
                    f"the column '{name}' has {len(column)} values for {len(times)} states"
                )
        if not len(times):
            return []
        results = []
        latest = self._latest
        if latest is None:
            latest = int(times[0])
            results = self._progress_first(latest, values_at(recording, 0))
            times, recording = times[1:], {name: each[1:] for name, each in recording.items()}
        steps = np.diff(times, prepend=latest)
        return results + self._progress_recording(ensemble, times, steps, recording)

    def fail(self, error: ReasoningError, valid_time: int) -> list[FormulaResult]:
        """Gives up all undecided formulas, for a state that cannot be used.

        Args:
            error: what is wrong with the state.
            valid_time: of that state, in nanoseconds.
        """
        results = [self._failed(each, error, valid_time) for each in sorted(self._undecided)]
        if self._ensemble:
            self._ensemble.drop(self._undecided)
        return self._end(results)

    def residual(self, formula_id: int) -> str:
        """The canonical text of what remains of a formula.

        After a state its intervals count from there, and it speaks of the states to come.

        Raises:
            ReasoningError: for an unknown formula.
        """
        if formula_id not in self._formulas:
            raise ReasoningError(
                f'the formula group has no formula {formula_id}', ExitCode.NOT_FOUND
            )
        latest = self._latest
        if latest is None or self._ensemble is None:
            return str(self._formulas[formula_id])
        if formula_id not in self._undecided:
            return self._ends[formula_id]
        texts = {
            member.order: remaining_text(location.node, times, latest, member.instance.atoms)
            for member, location, times in self._ensemble.wheres(latest)
            if member.formula_id == formula_id
        }
        ordered = [texts[order] for order in sorted(texts)]
        return reduce(lambda left, right: f'({left}) and ({right})', ordered)

    def _progress_first(self, valid_time: int, values: Values) -> list[FormulaResult]:
        ensemble = self._begun()
        self._latest = valid_time
        known = self._decide_at_once(valid_time)
        outcome = ensemble.progress(valid_time, 0, values)
        return known + (self._take(outcome, valid_time, values) if outcome else [])

    def _progress_recording(
        self, ensemble: Ensemble, times: Array, steps: Array, recording: Recording
    ) -> list[FormulaResult]:
        usable = int(np.argmax(steps <= 0)) if (steps <= 0).any() else len(times)
        results: list[FormulaResult] = []
        ahead = times[:usable].tolist()
        for index, outcome in ensemble.progress_many(ahead, steps[:usable].tolist(), recording):
            results += self._take(outcome, ahead[index], values_at(recording, index))
        if usable:
            self._latest = ahead[-1]
        if usable < len(times):
            results += self.progress(int(times[usable]), values_at(recording, usable))
        return results

    def _begun(self) -> Ensemble:
        if self._ensemble is None:
            raise ReasoningError('the formula group has not begun; give it the domains first')
        return self._ensemble

    def _members(self) -> Iterator[Member]:
        """The instances that need states."""
        for formula_id, instances in self._instances.items():
            for order, instance in enumerate(instances):
                if type(instance.node) is not Constant:
                    yield Member(formula_id, order, instance, self._formulas[formula_id].kinds)

    def _decide_at_once(self, valid_time: int | None) -> list[FormulaResult]:
        known, self._known = self._known, {}
        results = [
            self._decided(formula_id, verdict, valid_time, _WHATEVER[verdict])
            for formula_id, verdict in known.items()
            if formula_id in self._undecided
        ]
        if results:
            self._begun().drop([result.formula_id for result in results])
        return self._end(results)

    def _take(self, outcome: Outcome, valid_time: int, values: Values) -> list[FormulaResult]:
        """The results that a state brings."""
        results = [
            self._failed(formula_id, error, valid_time)
            for formula_id, error in outcome.failures.items()
        ]
        for formula_id, finish in outcome.decisions.items():
            verdict = Verdict.TRUE if finish.verdict else Verdict.FALSE
            why = explain(finish, values)
            results.append(self._decided(formula_id, verdict, valid_time, why))
        return self._end(sorted(results, key=attrgetter('formula_id')))

    def _end(self, results: list[FormulaResult]) -> list[FormulaResult]:
        """Goes on without the formulas that have a result."""
        for result in results:
            self._undecided.discard(result.formula_id)
            decided = result.verdict is not Verdict.UNDECIDED
            true = str(result.verdict is Verdict.TRUE).lower()
            self._ends[result.formula_id] = (
                true if decided else str(self._formulas[result.formula_id])
            )
        return results

    def _decided(
        self, formula_id: int, verdict: Verdict, valid_time: int | None, why: str
    ) -> FormulaResult:
        name = self._formulas[formula_id].name
        return FormulaResult(formula_id, name, verdict, valid_time, why)

    def _failed(self, formula_id: int, error: ReasoningError, valid_time: int) -> FormulaResult:
        name = self._formulas[formula_id].name
        located = ReasoningError(f'at {round_time(valid_time)}: {error}', error.code)
        return FormulaResult(formula_id, name, Verdict.UNDECIDED, None, '', located)


def _verdict(instances: Sequence[Instance]) -> Verdict:
    """What is known of a formula before any state."""
    if any(instance.node is FALSE for instance in instances):
        return Verdict.FALSE
    decided = all(type(instance.node) is Constant for instance in instances)
    return Verdict.TRUE if decided else Verdict.UNDECIDED


def _not_later(valid_time: int, latest: int) -> ReasoningError:
    return ReasoningError(
        f'the valid time {format_time(valid_time)} is not later than {format_time(latest)}, '
        'that of the state before; valid times must increase',
        ExitCode.CONSTRAINT_VIOLATION,
    )
