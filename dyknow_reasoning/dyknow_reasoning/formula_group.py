"""Formula groups: formulas over one stream of states and one domain for each sort (VI-A.6).

A formula passes through these stages: `parse_formula` parses it (language), `instances_of` makes
its instances when the domains are known (progression), `InstanceMonitor` progresses them over the
states (execution), and `explain` gives the reasons of the verdict (explanation).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import chain, count
from typing import Any

from dyknow_common import (
    Alternatives,
    ExitCode,
    Margin,
    ProbabilityInterval,
    Symbol,
    Verdict,
    earliest,
    round_time,
)
from dyknow_common.errors import error_text
from dyknow_reasoning.errors import ReasoningError, evaluation_error
from dyknow_reasoning.execution import (
    InstanceMonitor,
    InstanceVerdict,
    Outcome,
    PossibleFormulas,
    PossibleVerdict,
    Recording,
)
from dyknow_reasoning.explanation.explanation import VerdictReasons, explain, without_states
from dyknow_reasoning.explanation.remainders import Remainders, possible_text
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants
from dyknow_reasoning.language.formula import Formula, contains
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.spatial import Over
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.language.type_checking import check_asked_once, check_types
from dyknow_reasoning.margins.group_margins import GroupMargins
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import (
    Domains,
    Instance,
    instances_of,
    required_features,
    verdict_of,
)
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology
from dyknow_reasoning.progression.residual import holds_at_the_end
from dyknow_reasoning.progression.sizes import (
    Counts,
    FormulaLimits,
    check_size,
    formula_size,
    object_counts,
)
from dyknow_reasoning.progression.unknown_features import ALL_KNOWN, UnknownFeatures
from dyknow_reasoning.results import FormulaResult, NamedFormula
from dyknow_reasoning.standing import NONE_OMITTED, StandingFormula, StandingFormulas
from dyknow_reasoning.uncertain import UncertainFormula, meeting

_MAX_NODES = 10_000
DEFAULT_LIMITS = FormulaLimits()


class FormulaGroup:
    """Formulas that are progressed over the same states, each until it is decided.

    Add formulas, call `begin` with the domains, then `progress` for each state. Formulas may be
    added and removed at any time. Methods raise ReasoningError for an unknown formula id, and if
    they need the domains before `begin`.

    Args:
        limits: a formula that exceeds one is refused before any work is done, but for
            `node_limit`: a formula with more nodes for a choice of objects is refused after its
            simplification, and one that grows to more by progression fails.
    """

    def __init__(self, limits: FormulaLimits = DEFAULT_LIMITS) -> None:
        self._limits = limits
        # The number of parts of each formula: of its text; after `begin`, for all objects.
        self._sizes: dict[int, int] = {}
        self._ids = count(1)
        self._formulas: dict[int, NamedFormula] = {}
        self._instances: dict[int, list[Instance]] = {}
        self._margins = GroupMargins(limits.node_limit)
        self._counts: dict[str, int] = {}
        self.standing = StandingFormulas()
        """The formulas that are asked at every state."""
        self._possible = PossibleFormulas(limits)
        # May meet alternatives.
        self._uncertain: dict[int, UncertainFormula] = {}
        self._undecided: set[int] = set()
        self.waiting: dict[int, int] = {}
        """The valid times before which formulas do not begin, in nanoseconds, until they do."""
        # The verdicts of formulas that need no state, until they are reported.
        self._known: dict[int, Verdict] = {}
        # The residual texts of formulas that have a result.
        self._ends: dict[int, str] = {}
        self._store = NodeStore(Chronology())
        self._max_nodes = _MAX_NODES
        self._domains: Domains | None = None
        self._monitor = InstanceMonitor(limits.node_limit)
        self._remainders = Remainders(self._monitor)
        # True if beside the monitor, only standing formulas depend on the states.
        self._is_alone = False

    @property
    def formulas(self) -> Mapping[int, NamedFormula]:
        """The formulas by their ids."""
        return self._formulas

    @property
    def parts(self) -> int:
        """The parts of all formulas: in their texts; after `begin`, for all objects."""
        return sum(tuple(self._sizes.values()))

    @property
    def undecided(self) -> AbstractSet[int]:
        """The ids of the formulas without a result; empty before `begin`."""
        return self._undecided

    def add_formula(
        self,
        name: str,
        text: str,
        constants: Constants = NO_CONSTANTS,
        *,
        margin: bool = False,
        every_state: bool = False,
        since: int | None = None,
    ) -> int:
        """Add a formula and return its id.

        If the group has begun, the formula begins with the next state.

        Args:
            name: the name of the formula.
            text: the formula.
            constants: the values of names that the text does not define, from `parse_constants`.
            margin: True to compute its margin, too.
            every_state: True to ask it at every state; its verdicts are in `standing`.
            since: let it begin with the first state that is valid then, in nanoseconds, or later.

        Raises:
            LanguageError: for a text that is not a formula or is badly typed, with the position.
            ReasoningError: if the group has begun, for a sort without a domain, or a formula that
                is too large for its domains; if a margin is requested that is not defined.
        """
        formula = parse_formula(text, constants)
        named = NamedFormula(name, formula, check_types(formula, text), every_state)
        parts, instances = self._sized(formula)
        formula_id = next(self._ids)
        if margin:
            self._margins.add(formula_id, named, looks_back=self._monitor.histories.keeps(formula))
        self._formulas[formula_id], self._sizes[formula_id] = named, parts
        if since is not None:
            self.waiting[formula_id] = since
        if self._domains is not None:
            self._begin_formula(formula_id, instances)
        return formula_id

    def _sized(self, formula: Formula) -> tuple[int, list[Instance]]:
        """Return the parts of another formula, and if the objects are known, its instances."""
        size = formula_size(formula, self._counts)
        if self._domains is None:
            return size.parts, []
        self._limit_nodes()
        check_size(size, self._limits, others=self.parts)
        return size.parts, self._instances_of(formula, self._domains)

    def remove_formula(self, formula_id: int) -> None:
        """Remove a formula."""
        self._find(formula_id)
        if formula_id in self.undecided:
            self._monitor.remove([formula_id])
        self._release(formula_id)
        self._margins.remove(formula_id)
        self.standing.remove(formula_id)
        for each in (self._formulas, self._sizes, self._instances, self._known, self._ends):
            each.pop(formula_id, None)

    def symbols(self) -> list[Symbol]:
        """Return the symbols of all formulas, each once.

        Before `begin`, these are the symbols of the texts; an argument of a feature is an object,
        or the sort of the variable there. After `begin`, they are the features of objects that the
        simplified formulas depend on: the fields that each state must hold.
        """
        if self._domains is not None:
            return required_features(chain.from_iterable(self._instances.values()))
        found = (symbol for each in self._formulas.values() for symbol in symbols_of(each.formula))
        return list(dict.fromkeys(found))

    def parts_for(self, domains: Domains) -> int:
        """Return the number of parts that all formulas have for the objects of each sort.

        Raises:
            ReasoningError: for too many objects, or a formula that is too large for them.
        """
        return sum(self._sizes_for(object_counts(domains, self._limits)).values())

    def begin(self, domains: Domains, unknown: UnknownFeatures = ALL_KNOWN) -> None:
        """Fix the objects of each sort.

        Args:
            domains: the objects of each sort.
            unknown: the features that may be unknown at a state: absent, None or not a number. A
                verdict holds whatever their values are. For other features, this is an error.

        Raises:
            ReasoningError: for a sort without a domain, for a formula that is too large for the
                domains, or if the group has begun before.
        """
        if self._domains is not None:
            raise ReasoningError('the formula group has begun already', ExitCode.ALREADY_EXISTS)
        counts = object_counts(domains, self._limits)
        sizes = self._sizes_for(counts)
        instances = {
            formula_id: self._instances_of(each.formula, domains)
            for formula_id, each in self._formulas.items()
        }
        self._margins.begin(domains, unknown)
        self._domains, self._sizes = domains, sizes
        self._possible.unknown = unknown
        self._counts.update(counts)
        for formula_id, found in instances.items():
            self._begin_formula(formula_id, found)
        self._monitor.prepare()

    def keep_history(self, text: str) -> None:
        """Let formulas of a text that are added later look back to all states from now on.

        Otherwise, the past of a formula begins with the first state after it was added. Values must
        not have alternatives then.

        Raises:
            DyKnowError: as `add_formula`; also before `begin`.
        """
        domains, histories, formula = self._begun(), self._monitor.histories, parse_formula(text)
        check_asked_once(formula)
        check_size(formula_size(formula, self._counts), self._limits)
        instances = self._instances_of(formula, domains)
        histories.keep(formula, instances, check_types(formula, text))
        self._is_alone = False

    @property
    def keeps_history(self) -> bool:
        """True if later formulas may look back: `progress` must be called for each state."""
        return self._monitor.histories.are_kept

    def decided_at_once(self) -> list[FormulaResult]:
        """Return the results of the formulas that need no state.

        Their `decided_at` is None. Without a call they are returned with the first state.
        """
        self._begun()
        self._known |= self.standing.known()
        return self._results_of_known()

    def progress(self, valid_time: int, values: Values) -> list[FormulaResult]:
        """Progress all undecided formulas over a state; return the new results.

        A formula fails if the state lacks a field that the formula still depends on, or holds an
        unusable value there, unless the feature may be unknown. All formulas fail if the valid time
        is not later than the previous. A verdict holds for all `Alternatives` of the values.

        Args:
            valid_time: the valid time of the state, in nanoseconds.
            values: a value for each feature of objects, by the text of its `Symbol`.
        """
        if self._is_alone and not Alternatives.exist:
            standing = self.standing
            try:
                outcomes = self._monitor.progress(valid_time, values)
                if standing.formulas and (failed := standing.progress(valid_time, values)):
                    outcomes = {**outcomes, **failed}
            except Exception as error:  # noqa: BLE001 - no formula goes on after a fault
                return self.fail(error, valid_time)
            return self._results_of(outcomes, valid_time, values) if outcomes else []
        if self.waiting:
            self._begin_waiting(valid_time)
        if Alternatives.exist and Alternatives.are_among(values.values()):
            return self._progress_alternatives(valid_time, values)
        return self._progress(valid_time, values, values)

    def _progress_alternatives(self, valid_time: int, values: Values) -> list[FormulaResult]:
        """Progress over values that have alternatives."""
        met = meeting(self._uncertain, values)
        for formula_id in met.dependent:
            self._margins.forget(formula_id)
            self.standing.forget_margins(formula_id)
        differing = met.differing.keys() - self._possible.formulas.keys()
        met.fail(self._take_as_possible(sorted(differing)))
        self._monitor.remove(met.failures)
        results = self._results_of(met.failures, valid_time, {})
        return results + self._progress(valid_time, earliest(values), values, met.omitted)

    def _progress(
        self,
        valid_time: int,
        values: Values,
        given: Values,
        omitted: Mapping[int, str] = NONE_OMITTED,
    ) -> list[FormulaResult]:
        """Progress over `values`; formulas that have met alternatives take the `given` values."""
        self._begun()
        monitor, possible, standing = self._monitor, self._possible, self.standing
        results = self._results_of_known() if self._known else []
        try:
            met = possible.met(values) if possible.waiting else ()
            left = self._take_as_possible(met) if met else ()
            if margins := self._margins.running:
                self._margins.progress(valid_time, values)
            if looks_back := monitor.histories.registers or monitor.histories.memories:
                values = monitor.histories.extended(valid_time, values)
            outcomes: Mapping[int, Outcome | PossibleVerdict] = monitor.progress(valid_time, values)
            if left:
                outcomes = {**outcomes, **possible.errors_at_gap(left, outcomes, self._instances)}
            if standing.formulas and (failed := standing.progress(valid_time, values, omitted)):
                outcomes = {**outcomes, **failed}
            if possible.formulas:
                outcomes = {**outcomes, **possible.progress(valid_time, given)}
        except Exception as error:  # noqa: BLE001 - no formula goes on after a fault
            return results + self.fail(error, valid_time)
        if outcomes:
            return results + self._results_of(outcomes, valid_time, values)
        others = self.waiting or margins or looks_back or possible.waiting or possible.formulas
        self._is_alone = not others
        return results

    def progress_many(
        self, valid_times: Iterable[int], columns: Mapping[str, Iterable[Any]]
    ) -> list[FormulaResult]:
        """Progress all undecided formulas over many states; return the new results.

        Args:
            valid_times: the valid times of the states, in nanoseconds; may be a numpy array.
            columns: for each feature of objects, its values at the states; may be numpy arrays.

        Raises:
            ReasoningError: for columns of different lengths.
        """
        self._begun()
        monitor, recording = self._monitor, Recording.read(valid_times, columns)
        one_by_one = self.standing.formulas or self._margins.running or Alternatives.exist
        if one_by_one or self.waiting or not self._possible.are_known(recording.columns):
            rows = recording.rows(recording.columns.keys())
            return list(chain.from_iterable(self.progress(*each) for each in rows))
        usable = recording.increasing(monitor.latest)
        results = self._results_of_known() if len(usable) else []
        try:
            if monitor.histories.registers or monitor.histories.memories:
                usable = monitor.histories.extended_recording(usable)
            for index, outcomes in monitor.progress_many(usable):
                results += self._results_of(outcomes, usable.time(index), usable.values(index))
        except Exception as error:  # noqa: BLE001 - no formula goes on after a fault
            return results + self.fail(error, usable.time(0))
        end = len(usable)
        if end < len(recording):
            results += self.progress(recording.time(end), recording.values(end))
        return results

    def gap(self) -> None:
        """Record that states may be missing before the next one, any number with any values.

        No verdict depends on them: see `progression.gaps`. A formula that can become neither true
        nor false fails. Formulas that have seen no state are not affected.
        """
        self._begun()
        for each in (self._monitor, self._possible, self._margins, self.standing):
            each.gap()

    def fail(self, error: Exception, valid_time: int) -> list[FormulaResult]:
        """Fail all undecided formulas, and return their results.

        Args:
            error: the reason; see `evaluation_error`.
            valid_time: the valid time of the unusable state, in nanoseconds.
        """
        failed = sorted(self.undecided)
        self._monitor.remove(failed)
        return self._results_of(dict.fromkeys(failed, evaluation_error(error)), valid_time, {})

    def residual(self, formula_id: int) -> str:
        """Return what remains of a formula, for the states to come, in the words of the formula.

        After a state, its intervals count from that state. Only the first instances of a very large
        formula are shown.
        """
        formula = self._find(formula_id)
        if formula_id in self._ends:
            return self._ends[formula_id]
        if possible := self._possible.formulas.get(formula_id):
            return possible_text(possible, self._monitor.latest or 0)
        if standing := self.standing.formulas.get(formula_id):
            want = self.standing.omitted.get(formula_id) or standing.monitor.doubt.text
            return f'{formula} ({want})' if want else str(formula)
        return self._remainders.text(formula_id) or str(formula)

    def wants(self, formula_id: int) -> Mapping[str, int]:
        """Return since when each open feature makes a difference to a formula, in nanoseconds.

        The value of an open feature is unknown, or has `Alternatives`. For a formula that is asked
        at every state, return the features by which it may be violated at present.
        """
        self._find(formula_id)
        if formula_id in self.standing.formulas:
            return self.standing.formulas[formula_id].monitor.doubt.wants
        possible = self._possible.formulas.get(formula_id)
        return possible.wants if possible else {}

    def margin(self, formula_id: int) -> Margin | None:
        """Return the margin at present or at the end, the least so far if standing; or None."""
        self._find(formula_id)
        return self._margins.of(formula_id)

    def probability(self, formula_id: int) -> ProbabilityInterval | None:
        """Return the interval of the probabilities that an undecided formula asks for, if any."""
        return self._monitor.histories.probability(formula_id)

    def presumably_false(self, formula_id: int) -> bool:
        """Return True if a formula would be false if no further state came (RV-LTL).

        Then all that must always hold does, and all that must eventually hold does not. After a
        gap, this is about the formula of `residual`. Return False for a formula that failed, and
        before `begin`. For one that is asked at every state, return True while it is violated.
        """
        is_standing = self._find(formula_id).every_state
        if formula_id in self._ends:
            return self._ends[formula_id] == 'false'
        if is_standing:
            standing = self.standing.formulas.get(formula_id)
            return standing is not None and standing.monitor.is_violated
        if met := self._possible.formulas.get(formula_id):
            return not met.holds_at_the_end()
        begun = [each.node for each in self._instances.get(formula_id, ())]
        return not all(map(holds_at_the_end, self._remainders.nodes(formula_id) or begun))

    def _begun(self) -> Domains:
        if self._domains is None:
            raise ReasoningError('the formula group has not begun; give it the domains first')
        return self._domains

    def _find(self, formula_id: int) -> NamedFormula:
        if formula_id not in self._formulas:
            raise ReasoningError(
                f'the formula group has no formula {formula_id}', ExitCode.NOT_FOUND
            )
        return self._formulas[formula_id]

    def _sizes_for(self, counts: Counts) -> dict[int, int]:
        """Return the number of parts of each formula, after it was checked."""
        sizes, total = dict[int, int](), 0
        for formula_id, each in tuple(self._formulas.items()):
            size = formula_size(each.formula, counts)
            check_size(size, self._limits, others=total)
            sizes[formula_id] = size.parts
            total += size.parts
        return sizes

    def _instances_of(self, formula: Formula, domains: Domains) -> list[Instance]:
        return instances_of(formula, domains, self._store, self._limits.node_limit)

    def _limit_nodes(self) -> None:
        """Drop the nodes of removed formulas if there are many."""
        if len(self._store) > self._max_nodes:
            known = chain.from_iterable(self._instances.values())
            self._store = NodeStore(Chronology(), {instance.node for instance in known})
            self._max_nodes = max(_MAX_NODES, 2 * len(self._store))

    def _begin_waiting(self, valid_time: int) -> None:
        """Begin the formulas that may begin with a state."""
        for formula_id in [each for each, since in self.waiting.items() if since <= valid_time]:
            del self.waiting[formula_id]
            self._begin_formula(formula_id, self._instances[formula_id])

    def _begin_formula(self, formula_id: int, instances: list[Instance]) -> None:
        """Begin a formula with the next state, unless it waits for a later one."""
        named, verdict, domains = self._formulas[formula_id], verdict_of(instances), self._begun()
        self._instances[formula_id], self._is_alone = instances, False
        self._undecided.add(formula_id)
        if formula_id in self.waiting and not verdict:
            return
        self.waiting.pop(formula_id, None)
        self._margins.start(formula_id)
        histories = self._monitor.histories
        instances = histories.attach(formula_id, named.formula, instances, named.kinds)
        self._instances[formula_id] = instances
        self._uncertain[formula_id] = UncertainFormula(named, instances, domains)
        if named.every_state:
            given = formula_id, named, self._counts, instances, histories, self._limits
            standing = StandingFormula(*given, self._margins.standing(formula_id))
            self.standing.add(formula_id, standing)
            if self._watch(formula_id, named.formula, instances):
                standing.monitor.may_meet_unknown()
        elif verdict:
            self._known[formula_id] = verdict
        else:
            self._watch(formula_id, named.formula, instances)
            self._monitor.add(formula_id, instances, named.kinds)

    def _watch(self, formula_id: int, formula: Formula, instances: Sequence[Instance]) -> bool:
        """Watch unknown values; return True if there may be some. Over links, each is an error."""
        return not contains(formula, Over) and self._possible.watch(formula_id, instances)

    def _take_as_possible(self, formulas: Iterable[int]) -> list[int]:
        """Take formulas that meet open values from the monitor, before the state.

        Return the formulas that cannot be taken.
        """
        left, monitor = [], self._monitor
        states, registers = list(monitor.states()), monitor.histories.registers
        for formula_id in formulas:
            if standing := self.standing.formulas.get(formula_id):
                self._possible.remove(formula_id)
                if standing.meet_unknown(self._possible.unknown):
                    monitor.histories.release([formula_id])
                continue
            own = [each for each in states if each.instance.formula_id == formula_id]
            gap = monitor.gap_follows
            if self._possible.take(formula_id, own, registers, monitor.latest, after_gap=gap):
                monitor.remove([formula_id])
                monitor.histories.release([formula_id])
            else:
                left.append(formula_id)
        return left

    def _results_of_known(self) -> list[FormulaResult]:
        """Return the results of formulas that need no state, and forget that they were known."""
        known, self._known = self._known, {}
        return [
            self._end(each, verdict, None, without_states(self._formulas[each].formula, verdict))
            for each, verdict in known.items()
            if each in self.undecided
        ]

    def _results_of(
        self, outcomes: Mapping[int, Outcome | PossibleVerdict], valid_time: int, values: Values
    ) -> list[FormulaResult]:
        """Return the results of the formulas that a state decides, or that fail with it."""
        results = []
        for formula_id, outcome in outcomes.items():
            verdict, why, error = Verdict.UNDECIDED, VerdictReasons(''), None
            if isinstance(outcome, ReasoningError):
                self.standing.remove(formula_id)
                error = ReasoningError(f'at {round_time(valid_time)}: {outcome}', outcome.code)
            else:
                verdict = Verdict.TRUE if outcome.holds else Verdict.FALSE
                why = self._reasons(formula_id, outcome, values)
            results.append(self._end(formula_id, verdict, valid_time, why, error))
        return results

    def _reasons(
        self, formula_id: int, outcome: InstanceVerdict | PossibleVerdict, values: Values
    ) -> VerdictReasons:
        formula = self._formulas[formula_id].formula
        try:
            return explain(formula, self._counts, outcome, values, self._monitor.histories)
        except Exception as error:  # noqa: BLE001 - no fault in its reasons loses a verdict
            return VerdictReasons(f'its reasons are not known: {error_text(error)}')

    def _end(
        self,
        formula_id: int,
        verdict: Verdict,
        ended_at: int | None,
        why: VerdictReasons,
        error: ReasoningError | None = None,
    ) -> FormulaResult:
        """Return the result of a formula that needs no further state."""
        self._release(formula_id)
        named = self._formulas[formula_id]
        self._ends[formula_id] = str(named) if error else verdict.name.lower()
        return FormulaResult(
            formula_id,
            named.name,
            verdict,
            None if error else ended_at,
            why.text,
            error,
            why.objects,
            why.windows,
            ended_at,
            self._margins.end(formula_id),
        )

    def _release(self, formula_id: int) -> None:
        self._undecided.discard(formula_id)
        self.waiting.pop(formula_id, None)
        self._possible.remove(formula_id)
        self._uncertain.pop(formula_id, None)
        self._monitor.histories.release([formula_id])
