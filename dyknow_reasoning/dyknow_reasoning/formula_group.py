"""Formula groups: formulas over one stream of states and one domain for each sort (VI-A.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.evaluation import Decision, Evaluation
from dyknow_reasoning.grounding import ground
from dyknow_reasoning.nodes import NodeStore
from dyknow_reasoning.parsing import parse_formula
from dyknow_reasoning.progression import Progression
from dyknow_reasoning.results import FormulaResult, Verdict
from dyknow_reasoning.symbols import Symbol, ground_symbols, symbols_of
from dyknow_reasoning.type_checking import Kinds, check_types
from dyknow_stream_processing import ExitCode, format_time, round_time

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from dyknow_reasoning.atoms import Values
    from dyknow_reasoning.formula import Formula
    from dyknow_reasoning.grounding import Domains

DEFAULT_NODE_LIMIT = 100_000


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
        self._evaluations: dict[int, Evaluation] = {}
        self._undecided: dict[int, Evaluation] = {}
        self._progression = Progression(NodeStore())
        self._begun = False
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
        if self._begun:
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
        if self._begun:
            instances = (
                instance
                for evaluation in self._evaluations.values()
                for instance in evaluation.instances
            )
            return ground_symbols(instances)
        found = (symbol for each in self._formulas.values() for symbol in symbols_of(each.formula))
        return list(dict.fromkeys(found))

    def begin(self, domains: Domains) -> None:
        """Fixes the objects of each sort, in the order given.

        Raises:
            ReasoningError: for a sort without a domain, or when the group has begun before.
        """
        if self._begun:
            raise ReasoningError('the formula group has begun already', ExitCode.ALREADY_EXISTS)
        store = self._progression.store
        self._evaluations = {
            formula_id: Evaluation(
                ground(each.formula, domains, store), each.kinds, self._node_limit
            )
            for formula_id, each in self._formulas.items()
        }
        self._undecided = dict(self._evaluations)
        self._begun = True

    def decided_at_once(self) -> list[FormulaResult]:
        """The results of the formulas that are decided whatever the states are.

        Who does not ask gets them with the first state.
        """
        self._require_begun()
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
        if self._latest is None:
            self._require_begun()
            known = self._decide_at_once(valid_time)
            return known + self._progress(valid_time, 0, values)
        if valid_time <= self._latest:
            return self.fail(_not_later(valid_time, self._latest), valid_time)
        return self._progress(valid_time, valid_time - self._latest, values)

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
        times = _plain(valid_times)
        lists = {name: _plain(column) for name, column in columns.items()}
        for name, column in lists.items():
            if len(column) != len(times):
                raise ReasoningError(
                    f"the column '{name}' has {len(column)} values for {len(times)} states"
                )
        results = []
        for index, valid_time in enumerate(times):
            values = {name: column[index] for name, column in lists.items()}
            results += self.progress(valid_time, values)
        return results

    def fail(self, error: ReasoningError, valid_time: int) -> list[FormulaResult]:
        """Gives up all undecided formulas, for a state that cannot be used.

        Args:
            error: what is wrong with the state.
            valid_time: of that state, in nanoseconds.
        """
        results = [self._failed(each, error, valid_time) for each in self._undecided]
        return self._drop(results)

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
        if self._latest is None:
            return str(self._formulas[formula_id])
        return self._evaluations[formula_id].residual

    def _progress(self, valid_time: int, elapsed: int, values: Values) -> list[FormulaResult]:
        self._latest = valid_time
        results: list[FormulaResult] = []
        progression = self._progression
        for formula_id, evaluation in self._undecided.items():
            try:
                decision = evaluation.progress(valid_time, elapsed, values, progression)
            except ReasoningError as error:
                results.append(self._failed(formula_id, error, valid_time))
            else:
                if decision:
                    results.append(self._decided(formula_id, decision, valid_time))
        if progression.is_full:
            evaluations = self._undecided.values()
            progression.forget(root for evaluation in evaluations for root in evaluation.roots)
        return self._drop(results)

    def _require_begun(self) -> None:
        if not self._begun:
            raise ReasoningError('the formula group has not begun; give it the domains first')

    def _decide_at_once(self, valid_time: int | None) -> list[FormulaResult]:
        return self._drop(
            [
                self._decided(formula_id, decision, valid_time)
                for formula_id, evaluation in self._undecided.items()
                if (decision := evaluation.decide_at_once())
            ]
        )

    def _drop(self, results: list[FormulaResult]) -> list[FormulaResult]:
        """Goes on without the formulas that have a result."""
        for result in results:
            del self._undecided[result.formula_id]
        return results

    def _decided(
        self, formula_id: int, decision: Decision, valid_time: int | None
    ) -> FormulaResult:
        name = self._formulas[formula_id].name
        return FormulaResult(formula_id, name, decision.verdict, valid_time, decision.explanation)

    def _failed(self, formula_id: int, error: ReasoningError, valid_time: int) -> FormulaResult:
        name = self._formulas[formula_id].name
        located = ReasoningError(f'at {round_time(valid_time)}: {error}', error.code)
        return FormulaResult(formula_id, name, Verdict.UNDECIDED, None, '', located)


def _not_later(valid_time: int, latest: int) -> ReasoningError:
    return ReasoningError(
        f'the valid time {format_time(valid_time)} is not later than {format_time(latest)}, '
        'that of the state before; valid times must increase',
        ExitCode.CONSTRAINT_VIOLATION,
    )


def _plain(column: Iterable[Any]) -> list[Any]:
    """The values as plain Python objects."""
    values: list[Any] = column.tolist() if isinstance(column, np.ndarray) else list(column)
    return values
