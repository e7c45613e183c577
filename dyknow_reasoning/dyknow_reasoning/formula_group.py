"""Formula groups: formulas over one stream of states and one domain for each sort (VI-A.6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import chain, count
from operator import attrgetter
from typing import Any

import numpy as np

from dyknow_common import ExitCode, Symbol, Verdict, format_time, round_time
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.aggregation import StateOutcome
from dyknow_reasoning.execution.automata.templates import formula_instances
from dyknow_reasoning.execution.instance_monitor import InstanceMonitor
from dyknow_reasoning.execution.vectors.atom_vectors import Array, Recording, recorded
from dyknow_reasoning.execution.vectors.recordings import values_at
from dyknow_reasoning.explanation.explanation import explain
from dyknow_reasoning.explanation.remainders import Remainders
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.named_formula import NamedFormula
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.bounds import Chronology
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.instances import Domains, Instance, ground_symbols, instances_of
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import FALSE, Constant
from dyknow_reasoning.results import FormulaResult

DEFAULT_NODE_LIMIT = 100_000
_MOST_NODES = 10_000
_WHATEVER = {
    Verdict.TRUE: 'true for these objects, whatever the states are',
    Verdict.FALSE: 'false for these objects, whatever the states are',
}


class FormulaGroup:
    """Formulas that are progressed over the same states, each until it is decided.

    Add formulas, `begin` with the domains, then `progress` state by state. Formulas may come and go
    at any time.

    Args:
        node_limit: a formula that grows to more nodes by progression fails.
    """

    def __init__(self, node_limit: int = DEFAULT_NODE_LIMIT) -> None:
        self._node_limit = node_limit
        self._ids = count(1)
        self._formulas: dict[int, NamedFormula] = {}
        self._instances: dict[int, list[Instance]] = {}
        # The formulas that need no state, until that has been told.
        self._known: dict[int, Verdict] = {}
        self._ends: dict[int, str] = {}
        self._undecided: set[int] = set()
        self._store = NodeStore(Chronology())
        self._most_nodes = _MOST_NODES
        self._domains: Domains = {}
        self._ensemble: InstanceMonitor | None = None
        self._latest: int | None = None
        self._gap_follows = False
        self._remainders: Remainders | None = None

    @property
    def formulas(self) -> Mapping[int, NamedFormula]:
        """The formulas by their ids."""
        return self._formulas

    @property
    def undecided(self) -> AbstractSet[int]:
        """The ids of the formulas that have no result yet; none before `begin`."""
        return self._undecided

    def add_formula(self, name: str, text: str) -> int:
        """Adds a formula and returns its id.

        Once the group has begun, the formula begins with the next state.

        Raises:
            LanguageError: for a text that is no formula, or makes no sense; with the place.
            ReasoningError: once the group has begun, for a sort without a domain.
        """
        named = NamedFormula.parsed(name, text)
        self._forget_nodes()
        instances = (
            instances_of(named.formula, self._domains, self._store) if self._ensemble else []
        )
        formula_id = next(self._ids)
        self._formulas[formula_id] = named
        if self._ensemble:
            self._begin_formula(formula_id, instances, self._ensemble)
        return formula_id

    def remove_formula(self, formula_id: int) -> None:
        """Takes a formula out of the group; the others go on.

        Raises:
            ReasoningError: for an unknown formula.
        """
        self._find(formula_id)
        if self._ensemble and formula_id in self._undecided:
            self._ensemble.drop([formula_id])
        self._undecided.discard(formula_id)
        for known in (self._formulas, self._instances, self._known, self._ends):
            known.pop(formula_id, None)

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
        instances = {
            formula_id: instances_of(each.formula, domains, self._store)
            for formula_id, each in self._formulas.items()
        }
        self._domains = domains
        self._ensemble = InstanceMonitor(self._node_limit)
        self._remainders = Remainders(self._ensemble)
        for formula_id, found in instances.items():
            self._begin_formula(formula_id, found, self._ensemble)
        self._ensemble.admit(0)

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
        elapsed = valid_time - latest
        routine = self._ensemble.routine
        if routine and elapsed == routine.elapsed and routine.step(values):
            self._latest = valid_time
            return []
        results = self._before(self._ensemble, latest, valid_time, values)
        self._latest = valid_time
        outcome = self._ensemble.progress(valid_time, elapsed, values)
        return results + self._take(outcome, valid_time, values) if outcome else results

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
        return results + self._progress_recording(ensemble, latest, times, steps, recording)

    def gap(self) -> None:
        """Tells that states may be missing before the next one, any number with any values.

        No verdict depends on them: see `gaps`. A formula that can become neither true nor false
        any more fails. Formulas that have seen no state begin with the next one as ever.

        Raises:
            ReasoningError: before `begin`.
        """
        self._begun().interrupt()
        self._gap_follows = self._latest is not None

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
        named = self._find(formula_id)
        if formula_id in self._ends:
            return self._ends[formula_id]
        if self._latest is None or self._remainders is None or formula_id in self._known:
            return str(named)
        return self._remainders.text(formula_id, self._latest) or str(named)

    def presumably_false(self, formula_id: int) -> bool:
        """Whether a formula would be false if no further state came (RV-LTL).

        Then what shall always hold does, and what shall come about does not. After a gap it is told
        of what `residual` shows. False for one that failed, and where nothing is known yet.

        Raises:
            ReasoningError: for an unknown formula.
        """
        self._find(formula_id)
        if formula_id in self._ends:
            return self._ends[formula_id] == 'false'
        if formula_id in self._known or self._remainders is None:
            return self._known.get(formula_id) is Verdict.FALSE
        return not self._remainders.holds_at_the_end(formula_id, self._latest or 0)

    def _progress_first(self, valid_time: int, values: Values) -> list[FormulaResult]:
        ensemble = self._begun()
        self._latest = valid_time
        known = self._decide_at_once(valid_time)
        outcome = ensemble.progress(valid_time, 0, values)
        return known + self._take(outcome, valid_time, values) if outcome else known

    def _before(
        self, ensemble: InstanceMonitor, latest: int, valid_time: int, values: Values
    ) -> list[FormulaResult]:
        """What is known as soon as a state has come, before it is looked at."""
        results = self._decide_at_once(valid_time) if self._known else []
        if self._gap_follows:
            self._gap_follows = False
            results += self._take(ensemble.cross(Gap(latest, valid_time)), valid_time, values)
        return results

    def _progress_recording(
        self,
        ensemble: InstanceMonitor,
        latest: int,
        times: Array,
        steps: Array,
        recording: Recording,
    ) -> list[FormulaResult]:
        usable = int(np.argmax(steps <= 0)) if (steps <= 0).any() else len(times)
        results: list[FormulaResult] = []
        ahead = times[:usable].tolist()
        if ahead and (self._known or self._gap_follows):
            results += self._before(ensemble, latest, ahead[0], values_at(recording, 0))
        for index, outcome in ensemble.progress_many(ahead, steps[:usable].tolist(), recording):
            results += self._take(outcome, ahead[index], values_at(recording, index))
        if usable:
            self._latest = ahead[-1]
        if usable < len(times):
            results += self.progress(int(times[usable]), values_at(recording, usable))
        return results

    def _begun(self) -> InstanceMonitor:
        if self._ensemble is None:
            raise ReasoningError('the formula group has not begun; give it the domains first')
        return self._ensemble

    def _forget_nodes(self) -> None:
        """Drops the nodes of formulas that have left, when they have become many."""
        if len(self._store) > self._most_nodes:
            known = chain.from_iterable(self._instances.values())
            self._store = NodeStore(Chronology(), {instance.node for instance in known})
            self._most_nodes = max(_MOST_NODES, 2 * len(self._store))

    def _find(self, formula_id: int) -> NamedFormula:
        if formula_id not in self._formulas:
            raise ReasoningError(
                f'the formula group has no formula {formula_id}', ExitCode.NOT_FOUND
            )
        return self._formulas[formula_id]

    def _begin_formula(
        self, formula_id: int, instances: list[Instance], ensemble: InstanceMonitor
    ) -> None:
        self._instances[formula_id] = instances
        self._undecided.add(formula_id)
        if verdict := _verdict(instances):
            self._known[formula_id] = verdict
            ensemble.interrupt()
        else:
            ensemble.add(formula_instances(formula_id, instances, self._formulas[formula_id].kinds))

    def _decide_at_once(self, valid_time: int | None) -> list[FormulaResult]:
        known, self._known = self._known, {}
        return self._end(
            [
                self._decided(formula_id, verdict, valid_time, _WHATEVER[verdict])
                for formula_id, verdict in known.items()
                if formula_id in self._undecided
            ]
        )

    def _take(self, outcome: StateOutcome, valid_time: int, values: Values) -> list[FormulaResult]:
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
