"""The verdicts on a formula from every state on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import chain, compress, takewhile
from math import inf
from operator import ne, or_
from typing import Any, Final, TypeAlias

from dyknow_common import StandingVerdicts
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import JointReader, in_turn, joint_reader
from dyknow_reasoning.execution.past.registers import PastRegister
from dyknow_reasoning.execution.standing.groups import DecidedStarts
from dyknow_reasoning.execution.standing.open_starts import OpenStarts, open_starts
from dyknow_reasoning.execution.standing.possible_starts import PossibleDecision, PossibleStarts
from dyknow_reasoning.execution.standing.quiet_starts import QuietStarts, quiet_starts
from dyknow_reasoning.execution.standing.runs import (
    Run,
    StateTimes,
    count_outside,
    count_states,
    difference,
    number_in,
    union,
    union_of,
)
from dyknow_reasoning.execution.standing.verdicts import Failure, Failures, VerdictLog
from dyknow_reasoning.execution.unknown.parts import Instances
from dyknow_reasoning.execution.unknown.possible_formulas import (
    NO_DOUBT,
    Doubt,
    PossibleFormula,
    PossibleVerdict,
    possible_formula,
)
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, Half
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import TRUE
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.progression.unknown_features import UnknownFeatures

MAX_RUNS: Final = 100_000
"""The most runs of undecided or false start states that a formula may have."""

KEPT_FAILURES: Final = 10
"""The failures that are kept after they have ended."""

_CLEANUP_STATES: Final = 4096
"""The number of states between two clean-ups."""

_Decision: TypeAlias = DecidedStarts | PossibleDecision
_VerdictOf: TypeAlias = Callable[[Any, Run], InstanceVerdict | PossibleVerdict]
"""Given a decision and one of its runs, returns the verdict from the run's first state on."""


class StandingMonitor:
    """Evaluates a formula from every state on.

    Each verdict and its deciding state are as in an evaluation that begins at this state.

    Args:
        formula_id: the formula.
        instances: the formula holds if all of them do.
        kinds: the kinds of the features of the formula.
        limits: the limits of the formula.
    """

    def __init__(
        self, formula_id: int, instances: Sequence[Instance], kinds: Kinds, limits: FormulaLimits
    ) -> None:
        self._failures = Failures()
        self._times = StateTimes()
        found = [
            FormulaInstance.of(each, formula_id, order, kinds, batch_key=None)
            for order, each in enumerate(instances)
            if each.node is not TRUE
        ]
        templates = {node: Template(node) for node in {each.node for each in found}}
        self._templates = list(templates.values())
        self._starts = [open_starts(each, templates[each.node], self._times) for each in found]
        self._quiet = quiet_starts(self._starts, self._times, limits.node_limit)
        # Replaces `_starts` once the formula has met unknown values.
        self._possible: PossibleStarts | None = None
        self._keeps_times = False
        self._read = self._reader(kinds)
        # The truth of the atoms of each instance at the latest state, as bits; -1 if unknown.
        self._symbols = [-1] * len(self._starts)
        self._limits = limits
        self._keeps_failures = self._gap_follows = False
        # For each instance, `wakes_at` of its starts.
        self._ends: list[float] = [-inf] * len(self._starts)
        # The earliest of `_ends`: an earlier state with an unchanged symbol needs no step.
        self._wakes_at: float = -inf
        self._log: VerdictLog | None = None
        self._forgotten_fails = self._forgotten_unknown = 0
        # The starts from which the formula cannot become true, because of a gap.
        self._unprovable: list[Run] = []
        # With more times than this, a clean-up is due.
        self._most_kept = _CLEANUP_STATES

    def _reader(self, kinds: Kinds) -> JointReader:
        if any(each.instance.keeps_values for each in self._starts):
            return in_turn([each.reader() for each in self._starts])
        instances = (each.instance for each in self._starts)
        return joint_reader([(each.atoms, each.node.mask) for each in instances], kinds)

    def keep_all(self) -> VerdictLog:
        """Keep all failures, and return a log of all verdicts; call it before the first state."""
        self._keeps_failures, self._quiet = True, None
        self._log = VerdictLog()
        for each in self._starts:
            each.can_fade = False
        return self._log

    def may_meet_unknown(self) -> None:
        """Keep what `meet_unknown` needs."""
        self._keeps_times = True

    def meet_unknown(self, registers: Mapping[str, PastRegister], unknown: UnknownFeatures) -> bool:
        """Progress over unknown values, too, from the next state on.

        Args:
            registers: the registers of the past operators.
            unknown: the features that may be unknown.

        Returns:
            False if this is impossible, because a gap or an error affects a past operator.

        Raises:
            ReasoningError: if the formula is undecided from a state that is too long ago.
        """
        self._end_quiet()
        begun = [each.beginning for each in self._starts]
        of = Instances(begun, registers, unknown, self._limits)
        if not of.is_plain:
            return False
        beginning = possible_formula(of, begun, self._times.latest)
        possible = PossibleStarts(beginning, self._times, self._limits.possibility_limit)
        self._move_starts(possible, of)
        possible.add_false(self._failures.runs)
        self._possible = possible
        self._starts, self._symbols, self._ends = [], [], []
        self._read = in_turn(())
        self._templates, self._wakes_at, self._quiet = [], -inf, None
        return True

    def _move_starts(self, possible: PossibleStarts, of: Instances) -> None:
        """Move the undecided starts; starts that a gap has split are lost."""
        undecided = self.undecided()
        if undecided and self._times.is_forgotten(undecided[0].first):
            raise ReasoningError(
                'a value is unknown, and the formula is undecided from more than '
                f'{MAX_RUNS} states ago; give its operators shorter intervals'
            )
        for number in (each for run in undecided for each in range(run.first, run.last + 1)):
            run = Run(number, number, self._times[number], self._times[number])
            states = self.remainders(number)
            if gap := next((each.instance.gap for each in states if each.instance.gap), None):
                self._unprovable = union(self._unprovable, [run])
                if self._log:
                    self._log.unprovable[number] = gap
            else:
                possible.add(possible_formula(of, states, self._times.latest), [run])

    @property
    def doubt(self) -> Doubt:
        """The features whose values are lacking to know whether a failure has ended.

        There is doubt at each state with which a failure may have begun, and until it is certain
        that the formula holds after that state.
        """
        possible = self._possible
        if possible is None or possible.doubt is None:
            return NO_DOUBT
        number, before = possible.doubt
        is_so = possible.is_new_doubt or possible.is_suspect or not self._holds_after(number)
        return before.doubt if is_so else NO_DOUBT

    @property
    def is_lost_by_gap(self) -> bool:
        """True if no failure would become known from a state so far after a gap that followed now.

        Starts of a formula that has met unknown values are not progressed over gaps.
        """
        return self._possible is not None and self._possible.is_open

    def possible(self, number: int) -> PossibleFormula | None:
        """Return what remains from an undecided state on, if the formula met unknown values."""
        return self._possible.at(number) if self._possible else None

    def remainders(self, number: int) -> list[InstanceState]:
        """Return what remains of the formula from an undecided state on, for each instance."""
        self._settle()
        return [state for each in self._starts for state in each.states(number)]

    def undecided(self) -> list[Run]:
        """Return the states from which the formula is undecided."""
        return difference(self._undecided(), self._failures.runs)

    @property
    def states(self) -> int:
        """The number of states so far."""
        return len(self._times)

    @property
    def failures(self) -> Sequence[Failure]:
        """The failures in the order of their states; ended ones are forgotten after a while."""
        return self._failures.kept

    @property
    def failure_count(self) -> int:
        """The number of all failures, including forgotten ones."""
        return self._failures.count

    @property
    def is_violated(self) -> bool:
        """True if a failure has not ended."""
        return bool(self._failures.waiting)

    def progress(self, now: int, values: Values) -> bool:
        """Progress over a state; return True if a failure has begun or ended.

        Args:
            now: the valid time of the state, in nanoseconds, later than the latest one.
            values: the values of its features.

        Raises:
            ReasoningError: for values that cannot be used, or too many undecided starts.
        """
        symbols, kept = self._read(values), self._times.kept
        if symbols == self._symbols and now < self._wakes_at and len(kept) < self._most_kept:
            self._times.append(now)
            return False
        return self._step(symbols, now, values)

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._wakes_at = -inf
        self._gap_follows = len(self._times) > 0

    def counts(self) -> StandingVerdicts:
        """Return the numbers of starts by their verdicts, without the episodes."""
        states = len(self._times)
        false = self._failures.runs
        undecided = self._undecided()
        pending = count_outside(undecided, false)
        fails = self._forgotten_fails + count_states(false)
        unknown = count_outside(self._unprovable, union(false, undecided))
        unknown += self._forgotten_unknown
        return StandingVerdicts(states - fails - pending - unknown, fails, pending, unknown)

    @property
    def _all(self) -> Sequence[OpenStarts | PossibleStarts]:
        return [self._possible] if self._possible else self._starts

    def _undecided(self) -> list[Run]:
        """Return the starts from which an undecided instance still matters."""
        found: list[Run] = []
        if quiet := self._resting:
            starts: Sequence[OpenStarts | PossibleStarts] = quiet.representatives()
        else:
            self._settle()
            starts = self._all
        for half in Half:
            runs = chain.from_iterable(each.runs(half) for each in starts)
            joined = union_of(runs)
            if half is Half.PESSIMISTIC:
                joined = difference(joined, self._unprovable)
            found = union(found, joined)
        return found

    def _step(self, symbols: list[int], now: int, values: Values) -> bool:
        number = len(self._times)
        changed = False
        if self._gap_follows:
            changed = self._cross_gap(Gap(self._times[number - 1], now), values)
        if abs(now) > MAX_VECTOR_TIME:
            self._end_quiet()
        self._times.append(now)
        decided: list[tuple[_VerdictOf, _Decision]] = []
        if self._possible:
            possible = self._possible
            decided += [(possible.verdict, found) for found in possible.step(values)]
        quiet = self._resting
        stepped = quiet.progress(symbols) if quiet else self._changed(symbols, now)
        for index in stepped:
            starts = self._starts[index]
            decided += [(starts.verdict, found) for found in starts.step(symbols[index], number)]
            self._ends[index] = starts.wakes_at
        self._symbols = symbols
        changed |= self._apply(decided, now, values)
        self._limit_memory()
        changed |= self._end_failures()
        if self._quiet:
            self._quiet.count(len(stepped))
        if self._resting:
            self._wakes_at = -inf
            return changed
        if quiet:
            self._forget_symbols()
        self._wakes_at = -inf if self._possible else min(self._ends, default=inf)
        if self._failures.waiting:
            fading = (each.fades_at for each in self._starts)
            self._wakes_at = min([self._wakes_at, *fading])
        return changed

    def _changed(self, symbols: Sequence[int], now: int) -> list[int]:
        """Return the instances whose starts need a step."""
        has_changed = map(ne, symbols, self._symbols)
        if now >= self._wakes_at:
            has_changed = map(or_, has_changed, [now >= end for end in self._ends])
        return list(compress(range(len(symbols)), has_changed))

    @property
    def _resting(self) -> QuietStarts | None:
        """The open starts that may rest, if they do so now."""
        return self._quiet if self._quiet and self._quiet.is_active else None

    def _end_quiet(self) -> None:
        """Progress all starts up to the latest state; each of them needs a step at the next."""
        if self._resting:
            self._resting.end()
            self._forget_symbols()

    def _forget_symbols(self) -> None:
        self._symbols = [-1] * len(self._starts)

    def _cross_gap(self, gap: Gap, values: Values) -> bool:
        """Continue with the halves after a gap; return True if a failure has begun."""
        self._gap_follows = False
        self._end_quiet()
        self._forget_symbols()
        decided: list[tuple[_VerdictOf, _Decision]] = []
        for each in self._all:
            decided += [(each.verdict, found) for found in each.cross_gap(gap)]
        return self._apply(decided, gap.before, values)

    def _apply(
        self, decided: Iterable[tuple[_VerdictOf, _Decision]], now: int, values: Values
    ) -> bool:
        """Apply what a state decides; return True if a failure has begun."""
        false: list[tuple[Run, Callable[[Run], Failure]]] = []
        for verdict_of, found in decided:
            if self._log:
                self._log.add(found, now)
            if found.loss is not None:
                self._unprovable = union(self._unprovable, found.runs)
            elif not found.holds:
                failure_of = partial(_failure, verdict_of, found, now, values)
                false += [(run, failure_of) for run in found.runs]
        false.sort(key=lambda each: each[0].first)
        began = [self._failures.add(*each) for each in false]
        return any(began)

    def _end_failures(self) -> bool:
        """End failures after which the formula holds; return True if one has ended."""
        if not self._failures.waiting:
            return False
        if not self._resting:
            self._settle()
        ended = [each for each in self._failures.waiting if self._holds_after(each.run.last)]
        for failure in ended:
            self._failures.end(failure)
        return bool(ended)

    def _holds_after(self, last: int) -> bool:
        """Return True if the first start after one that is neither unknown nor false is true."""
        number = last + 1
        while number < len(self._times):
            if (end := self._failures.last_around(number)) is not None:
                number = end + 1
                continue
            is_unprovable = number_in(self._unprovable, number)
            if self._has_open(number, pessimistic=not is_unprovable):
                return False
            if not is_unprovable:
                return True
            number += 1
        return False

    def _has_open(self, number: int, *, pessimistic: bool) -> bool:
        if quiet := self._resting:
            return quiet.has_open(number, pessimistic=pessimistic)
        return any(each.has_open(number, pessimistic=pessimistic) for each in self._all)

    def _settle(self) -> None:
        if quiet := self._resting:
            quiet.settle()
            return
        states = len(self._times)
        for each in self._starts:
            each.catch_up(states)

    def _limit_memory(self) -> None:
        """Limit the memory of automata that have grown, and of times.

        Raises:
            ReasoningError: if more than `node_limit` remains of an instance, or of too many starts.
        """
        for template in self._templates:
            automaton = template.automaton
            if not automaton.has_grown:
                continue
            automaton.has_grown = False
            used = [each for each in self._starts if each.template is template]
            if automaton.max_size > self._limits.node_limit:
                for each in used:
                    each.check_size(self._limits.node_limit)
            if automaton.is_full:
                self._end_quiet()
                self._settle()
                automaton.forget({location for each in used for location in each.locations})
                for each in used:
                    each.resume(each.groups, len(self._times))
                self._forget_symbols()
        if self._resting:
            self._resting.limit_memory()
        if len(self._times.kept) > self._most_kept:
            self._clean_up()

    def _clean_up(self) -> None:
        """Forget what no undecided start needs any more, and limit the rest."""
        self._settle()
        states = len(self._times)
        runs = len(self._failures.kept) + sum(each.run_count() for each in self._all)
        if runs > MAX_RUNS:
            raise ReasoningError(
                f'there are {runs} runs of states from which the formula is undecided or false, '
                f'more than {MAX_RUNS}; give its operators shorter intervals'
            )
        is_own = not self._keeps_times
        oldest = min((each.oldest(own=is_own) for each in self._starts), default=states)
        if quiet := self._resting:
            oldest = min(oldest, quiet.first)
        self._times.forget(min(max(oldest, states - MAX_RUNS), states - 2))
        self._most_kept = len(self._times.kept) + _CLEANUP_STATES
        oldest = min((each.oldest(own=False) for each in self._all), default=states)
        waiting = (each.run.last for each in self._failures.waiting)
        oldest = min([oldest, *waiting])
        false = self._failures.runs
        unprovable = [run for run in self._unprovable if run.last < oldest]
        self._forgotten_unknown += count_outside(unprovable, false)
        del self._unprovable[: len(unprovable)]
        past = [] if self._keeps_failures else self._failures.kept[:-KEPT_FAILURES]
        forgotten = list(takewhile(lambda each: each.run.last < oldest, past))
        self._forgotten_fails += count_states(each.run for each in forgotten)
        del self._failures.kept[: len(forgotten)]


def _failure(
    verdict_of: _VerdictOf, found: _Decision, now: int, values: Values, run: Run
) -> Failure:
    """Return the failure from the states of a run on."""
    return Failure(run, verdict_of(found, run), now, values)
