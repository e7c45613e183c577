"""The undecided instances of a formula group, progressed state by state."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from math import inf

from dyknow_reasoning.errors import ReasoningError, late_state
from dyknow_reasoning.execution.aggregation import Outcome, Outcomes, VerdictAggregation
from dyknow_reasoning.execution.automata.automaton import Location, Move, Times
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
    bounded_halves,
)
from dyknow_reasoning.execution.block_progression import BlockProgression
from dyknow_reasoning.execution.instance_pool import InstancePool, Symbols
from dyknow_reasoning.execution.past.histories import Histories
from dyknow_reasoning.execution.past.operand_histories import OperandHistory
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    SharedVectors,
    UnreadableError,
    batch_key,
)
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, whole_past_atoms
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import Constant, Node
from dyknow_reasoning.progression.residual import growth_error

_NO_OUTCOMES: Outcomes = {}
_FIRST_STATES, _FEWEST_STATES, _MOST_STATES = 1 << 12, 1 << 4, 1 << 16
"""The numbers of states of a recording that are progressed together."""
_MIN_INSTANCES = 256
"""The fewest instances that are faster in a batch than one by one, over many states."""


class InstanceMonitor:
    """Progresses the instances of formulas until the formulas are decided or fail.

    Args:
        node_limit: a formula whose instances have more nodes together fails.

    `histories` are the histories of its formulas; they first add their fields to each state.
    """

    def __init__(self, node_limit: int) -> None:
        self._node_limit = node_limit
        self._shared_vectors = SharedVectors()
        self.histories = Histories(node_limit, self._shared_vectors)
        self.latest: int | None = None
        """The valid time of the latest state, in nanoseconds; None before the first state."""
        self._gap_follows = False
        self._aggregation = VerdictAggregation()
        self._templates: dict[Node, Template] = {}
        # The instances that begin with the next state.
        self._new: list[InstanceState] = []
        self._pool = InstancePool(self._shared_vectors)
        # True if all instances are progressed individually, and nothing precedes the next state.
        self._is_settled = False
        # The time before which states like earlier ones change nothing.
        self._wakes_at = -inf
        # True if a formula may be near the node limit.
        self._is_large = False

    def add(self, formula_id: int, instances: Sequence[Instance], kinds: Kinds) -> None:
        """Add a formula, which begins with the next state.

        Args:
            formula_id: the formula.
            instances: its instances; those that need no state are ignored.
            kinds: the kinds of its features.
        """
        self._is_settled = False
        for order, each in enumerate(instances):
            node = each.node
            if type(node) is Constant:
                continue
            memory = self.histories.memories.get(each)
            key = None if memory else batch_key(each, kinds)
            instance = FormulaInstance.of(each, formula_id, order, kinds, batch_key=key)
            self._new.append(self._begun(instance, memory))
            self._aggregation.add([instance])

    def remove(self, formulas: Collection[int]) -> None:
        """Remove formulas."""
        self._remove(formulas)
        self._aggregation.forget(formulas)

    @property
    def gap_follows(self) -> bool:
        """True if states may be missing between the latest one and the next."""
        return self._gap_follows

    def prepare(self) -> None:
        """Form batches of the instances that were added; otherwise the next state does that."""
        new, self._new = self._new, []
        self._place(list(self._after_gaps(new)), self.latest or 0)

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows, self._is_settled = self.latest is not None, False
        self.histories.gap()

    def progress(self, valid_time: int, values: Values) -> Outcomes:
        """Progress all instances over a state; return the outcomes in the order of the ids.

        Outcomes of a gap before the state precede the others.

        Args:
            valid_time: the valid time of the state, in nanoseconds.
            values: the values of the features.

        Raises:
            ReasoningError: if the valid time is not later than the latest state's.
        """
        latest = self.latest
        if latest is None or latest >= valid_time or not self._is_settled:
            return self._progress_unsettled(valid_time, values)
        singles = self._pool.singles
        try:
            if valid_time < self._wakes_at:
                for single in singles:
                    if single.read(values) not in single.idle:
                        break
                else:
                    self.latest = valid_time
                    return _NO_OUTCOMES
            symbols = [single.read(values) for single in singles]
        except ReasoningError:
            return self._progress_unsettled(valid_time, values)
        outcomes = self._step((symbols, ()), valid_time, valid_time - latest)
        return _by_id(outcomes) if outcomes else _NO_OUTCOMES

    def _progress_unsettled(self, valid_time: int, values: Values) -> Outcomes:
        """Do the same where instances begin, join, cross a gap or cannot read the values."""
        latest = valid_time if self.latest is None else self.latest
        elapsed = valid_time - latest
        if elapsed <= 0 and self.latest is not None:
            raise late_state(valid_time, latest)
        if not self._aggregation:
            self.latest, self._is_settled, self._wakes_at = valid_time, True, inf
            return _NO_OUTCOMES
        joins = self._pool.apart and self._pool.may_join()
        failures = self._refused() if self.histories.refused else _NO_OUTCOMES
        crossed = self._cross_gap(Gap(latest, valid_time)) if self._gap_follows else _NO_OUTCOMES
        if self._new or joins:
            self.prepare()
        if abs(valid_time) > MAX_VECTOR_TIME:
            self._pool.dissolve(latest, inf)
        try:
            symbols = self._pool.read(values)
        except (UnreadableError, ReasoningError):
            symbols, unreadable = self._read_apart(values, latest)
            failures = {**failures, **unreadable}
        self._is_settled = not (self._pool.batches or self._pool.apart)
        outcomes = self._step(symbols, valid_time, elapsed)
        if outcomes or failures or crossed:
            return {**crossed, **_by_id({**failures, **outcomes})}
        return _NO_OUTCOMES

    def progress_many(self, recording: Recording) -> Iterator[tuple[int, Outcomes]]:
        """Progress all instances over a recording, with the same results as `progress`.

        Args:
            recording: states whose valid times increase, and are later than the latest state.

        Returns:
            The indices of the states that have outcomes, and the outcomes.
        """
        steps = recording.steps(self.latest)
        index, size, count = 0, _FIRST_STATES, len(recording)
        while index < count and self._aggregation:
            end = min(index + min(size, self._pool.most_states), count)
            reached, outcomes = index, dict[int, Outcomes]()
            one_by_one = self._gap_follows or self._new or self._is_large or self._pool.keeps_values
            if not (self.latest is None or one_by_one):
                self._dissolve(recording, count - index)
                symbols = RecordedSymbols(recording, range(index, end))
                reached, outcomes = self._progress_block(recording, steps, symbols)
            if reached == index:
                now = recording.time(index)
                outcomes = {index: self.progress(now, recording.values(index))}
                reached += 1
            yield from ((each, found) for each, found in outcomes.items() if found)
            # Where blocks cannot be completed, smaller ones waste less work.
            size = min(2 * size, _MOST_STATES) if reached == end else max(size // 8, _FEWEST_STATES)
            index = reached
        self._is_settled = False
        self.latest = recording.time(-1) if count else self.latest

    def _read_apart(self, values: Values, latest: int) -> tuple[Symbols, dict[int, ReasoningError]]:
        """Return the truth of the atoms at a state that fits into no vectors, or is unusable.

        Return also the errors of formulas with unusable values, which are removed.
        """
        self._pool.separate(latest)
        failures = self._pool.errors(values)
        self.remove(failures)
        return self._pool.read(values), failures

    def _refused(self) -> Mapping[int, Outcome]:
        """Remove undecided formulas that begin now and cannot; return their errors."""
        found, self.histories.refused = self.histories.refused, {}
        refused = {each: found[each] for each in found if self._aggregation.count(each)}
        self.remove(refused)
        return refused

    def states(self) -> Iterator[InstanceState]:
        """Return the states of all instances."""
        yield from self._pool.states(self.latest or 0)
        yield from self._new

    def _progress_block(
        self, recording: Recording, steps: Array, symbols: RecordedSymbols
    ) -> tuple[int, dict[int, Outcomes]]:
        """Progress all instances over a block of states, or as many of them as is possible.

        Returns:
            The index of the next state, and the outcomes by the indices of their states.
        """
        pool = self._pool
        for single in pool.singles:
            symbols.of(single)
        if not symbols.states:
            return symbols.states.start, {}
        if pool.batches:
            return self._progress_with_batches(recording, steps, symbols)
        block = BlockProgression(recording.times, steps, symbols)
        end, pool.singles, verdicts = block.progress(pool.singles)
        found: dict[int, Outcomes] = {}
        for index, each in verdicts.items():
            outcomes, irrelevant = self._aggregation.apply(each)
            self._remove(outcomes, irrelevant)
            found[index] = _by_id(outcomes)
        self.latest = recording.time(end - 1)
        if failures := self._check_limits(self.latest):
            found[end - 1] = _by_id({**found.get(end - 1, {}), **failures})
        return end, found

    def _progress_with_batches(
        self, recording: Recording, steps: Array, symbols: RecordedSymbols
    ) -> tuple[int, dict[int, Outcomes]]:
        """Progress all instances state by state, which is fast for large batches."""
        pool, fields, states = self._pool, self._pool.fields, symbols.states
        try:
            batches = symbols.of_batches(pool)
        except UnreadableError:
            return states.start, {}
        singles = {id(single): symbols.of(single) for single in pool.singles}
        found: dict[int, Outcomes] = {}
        for row, index in enumerate(states):
            if pool.fields is not fields or self._is_large:
                return index, found
            now = (
                [singles[id(single)].values[row] for single in pool.singles],
                [batch.of_instances(batches[id(batch)][row]) for batch in pool.batches],
            )
            if outcomes := self._step(now, recording.time(index), int(steps[index])):
                found[index] = _by_id(outcomes)
        return states.stop, found

    def _dissolve(self, recording: Recording, states: int) -> None:
        """Progress the instances of batches individually if that is faster, or times are large."""
        latest = self.latest or 0
        if recording.times.dtype == object:
            self._pool.dissolve(latest, inf)
        elif states >= _MIN_INSTANCES:
            self._pool.dissolve(latest, _MIN_INSTANCES)

    def _step(self, symbols: Symbols, now: int, elapsed: int) -> Outcomes:
        """Progress all instances by the truth of their atoms; remove formulas with outcomes."""
        pool = self._pool
        singles, batches = symbols
        verdicts: list[InstanceVerdict] = []
        wakes_at: float = inf
        for single, symbol in zip(pool.singles, singles):  # noqa: B905 - strict is slower
            verdict = single.step(symbol & single.mask, now, elapsed)
            if verdict:
                verdicts.append(verdict)
            elif single.wakes_at < wakes_at:
                wakes_at = single.wakes_at
        self._wakes_at = wakes_at
        for batch, array in zip(pool.batches, batches, strict=True) if batches else ():
            verdicts += batch.step(array, now, elapsed)
        self.latest = now
        outcomes = _NO_OUTCOMES
        if verdicts:
            outcomes, irrelevant = self._aggregation.apply(verdicts)
            self._remove(outcomes, irrelevant)
        if failures := self._check_limits(now):
            outcomes = {**outcomes, **failures}
        return outcomes

    def _cross_gap(self, gap: Gap) -> Outcomes:
        """Continue with the halves of the instances after a gap; return outcomes by their ids."""
        self._gap_follows = False
        if gap.is_empty:
            return _NO_OUTCOMES
        verdicts: list[InstanceVerdict] = []
        remaining: list[InstanceState] = []
        known: dict[tuple[Location, Times, int], tuple[Move, Move]] = {}
        before = list(self._pool.states(gap.after))
        for state in before:
            past = whole_past_atoms(state.instance.atoms, state.node.mask)
            key = state.location, state.times, past
            if key not in known:
                known[key] = state.template.automaton.halves(state.location, state.times, gap, past)
            halves = state.after_gap(gap, known[key])
            if halves != [state]:
                self._aggregation.replace(state.instance, [half.instance for half in halves])
            for half in halves:
                holds = half.location.verdict
                if holds is None:
                    remaining.append(half)
                else:
                    verdicts.append(InstanceVerdict(half.instance, holds, None))
        if remaining == before:
            return _NO_OUTCOMES
        outcomes, _ = self._aggregation.apply(verdicts)
        self._pool = InstancePool(self._shared_vectors)
        self._place([each for each in remaining if each.instance in self._aggregation], gap.after)
        return _by_id(outcomes)

    def _after_gaps(self, states: Iterable[InstanceState]) -> Iterator[InstanceState]:
        """Replace new instances whose past has a gap by their halves."""
        for state in states:
            instance = state.instance
            gap = self.histories.gap_of(instance.atoms, instance.node.mask)
            if gap is None or instance.node.looks_back:  # Its own memory has no gap.
                yield state
                continue
            halves = list(map(self._begun, bounded_halves(instance, gap)))
            self._aggregation.replace(instance, [half.instance for half in halves])
            yield from (half for half in halves if half.instance in self._aggregation)

    def _begun(
        self, instance: FormulaInstance, memory: OperandHistory | None = None
    ) -> InstanceState:
        """Return the state of an instance before its first state, with what it remembers."""
        node, times = (memory.node, memory.times) if memory else (instance.node, ())
        template = self._templates.get(node)
        if template is None:
            template = self._templates[node] = Template(node)
        return InstanceState(instance, template, template.automaton.initial, times, {})

    def _place(self, states: Sequence[InstanceState], latest: int) -> None:
        """Add instances to the pool."""
        self._pool.add(states, latest)
        templates = [*self._pool.templates, *(state.template for state in self._new)]
        self._templates = {each.automaton.initial.node: each for each in templates}
        for state in states:
            safe_size = self._node_limit // self._aggregation.count(state.instance.formula_id)
            state.template.safe_size = min(state.template.safe_size, safe_size)
        self._is_large = any(template.is_large for template in self._templates.values())

    def _remove(self, formulas: Collection[int], instances: Iterable[FormulaInstance] = ()) -> None:
        self._is_settled = False
        self._pool.remove(formulas, instances)
        self._new = [each for each in self._new if each.instance.formula_id not in formulas]

    def _check_limits(self, now: int) -> Mapping[int, Outcome]:
        """Limit memory; remove formulas that are too large, and return their errors."""
        for template in self._templates.values():
            if template.automaton.has_grown:
                self._limit_memory(now)
        return self._check_sizes(now) if self._is_large else _NO_OUTCOMES

    def _limit_memory(self, now: int) -> None:
        """Limit the size of automata after one has grown, and check for large instances."""
        for template in self._templates.values():
            template.automaton.has_grown = False
            if template.is_full:
                template.forget(self._pool.leave_configurations(template, now))
        self._is_large = any(template.is_large for template in self._templates.values())

    def _check_sizes(self, now: int) -> Mapping[int, Outcome]:
        """Remove the formulas that exceed the node limit; return their errors."""
        failures: dict[int, Outcome] = {}
        for formula_id, size in self._pool.sizes().items():
            if size > self._node_limit:
                states = [
                    each
                    for each in self._pool.states(now)
                    if each.instance.formula_id == formula_id
                ]
                largest = max(states, key=lambda state: state.node.size)
                failures[formula_id] = growth_error(
                    size, self._node_limit, largest.node, largest.instance.atoms
                )
        if failures:
            self.remove(failures)
        return failures


def _by_id(outcomes: Mapping[int, Outcome]) -> Outcomes:
    return dict(sorted(outcomes.items())) if outcomes else _NO_OUTCOMES
