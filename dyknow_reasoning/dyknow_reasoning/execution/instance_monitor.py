"""The undecided instances of a formula group, progressed state by state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from dyknow_common import ExitCode
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.aggregation import StateOutcome, VerdictAggregation
from dyknow_reasoning.execution.automata.automaton import Location, Move, Times
from dyknow_reasoning.execution.automata.sampling import SamplingRegularity
from dyknow_reasoning.execution.automata.templates import (
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
    Template,
)
from dyknow_reasoning.execution.batching import assign_batches
from dyknow_reasoning.execution.fast_path import FastPath
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    FieldVectors,
    Recording,
    UnreadableError,
)
from dyknow_reasoning.execution.vectors.batch import Batch
from dyknow_reasoning.execution.vectors.recordings import RecordedSymbols, Symbols, values_at
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.nodes import Node

_MOST_IN_A_ROUTINE = 256
_ROUTINE_AFTER = 4

_NOTHING = StateOutcome()
_NO_FAILURES: Mapping[int, ReasoningError] = {}


class InstanceMonitor:
    """Progresses instances, each by itself or, of many of one shape, together.

    Args:
        node_limit: the nodes that the instances of a formula may have together.
    """

    def __init__(self, node_limit: int) -> None:
        self._node_limit = node_limit
        self._pace = SamplingRegularity()
        self._tally = VerdictAggregation()
        self._shapes: dict[Node, Template] = {}
        # Those that begin with the next state.
        self._newcomers: list[InstanceState] = []
        self._singles: list[SingleInstance] = []
        self._batches: list[Batch] = []
        self._columns = FieldVectors()
        # Whether a state usually takes no more than a look-up for each instance by itself.
        self._is_plain = False
        # Progresses all over such a state, or does nothing; to be tried before `progress`.
        self.routine: FastPath | None = None
        self._former_routine: FastPath | None = None
        self._plain_in_a_row = 0
        # Whether a formula may be near the node limit.
        self._is_large = False

    def add(self, members: Iterable[FormulaInstance]) -> None:
        """Takes on instances, which begin with the next state."""
        self._leave_routine()
        for member in members:
            node = member.instance.node
            shape = self._shapes.get(node)
            if shape is None:
                shape = self._shapes[node] = Template(node)
            seat = InstanceState(member, shape, shape.automaton.initial, (), {})
            self._newcomers.append(seat)
            self._tally.add([member])

    def admit(self, latest: int) -> None:
        """Gives those that have come their places; otherwise the next state does that.

        Args:
            latest: the valid time of the latest state; of no meaning before the first one.
        """
        newcomers, self._newcomers = self._newcomers, []
        self._seat(newcomers, latest)

    def interrupt(self) -> None:
        """Sees to it that the next state is progressed by `progress`, not by the routine."""
        self._leave_routine()

    def cross(self, gap: Gap) -> StateOutcome:
        """Goes on with what remains after a gap; drops what has become unknowable."""
        finishes: list[InstanceVerdict] = []
        found: list[InstanceState] = []
        known: dict[tuple[Location, Times], tuple[Move, Move]] = {}
        before = list(self._seats_taken(gap.after))
        for seat in before:
            key = seat.location, seat.times
            if key not in known:
                known[key] = seat.shape.automaton.across(*key, gap)
            halves = seat.across(gap, known[key])
            if halves != [seat]:
                self._tally.replace(seat.member, [half.member for half in halves])
            for half in halves:
                verdict = half.location.verdict
                if verdict is None:
                    found.append(half)
                else:
                    finishes.append(InstanceVerdict(half.member, verdict, None))
        if found == before:
            return _NOTHING
        outcome, _ = self._tally.take(finishes)
        self._singles, self._batches = [], []
        self._seat([seat for seat in found if seat.member in self._tally], gap.after)
        return outcome

    def progress(self, now: int, elapsed: int, values: Values) -> StateOutcome | None:
        """Progresses all over a state; drops the formulas that it decides or fails.

        Returns:
            None if there are none.

        Args:
            now: the valid time of the state, in nanoseconds.
            elapsed: since the state before; 0 at the first.
            values: of the ground features.
        """
        self._leave_routine()
        if self._newcomers:
            self.admit(now - elapsed)
        failures: Mapping[int, ReasoningError] = _NO_FAILURES
        try:
            symbols = [single.read(values) for single in self._singles]
            arrays = self._read_batches(values) if self._batches else ()
        except (UnreadableError, ReasoningError):
            symbols, arrays, failures = self._read_one_by_one(values)
        outcome = self._step(symbols, arrays, now, elapsed, failures)
        if self._is_plain:
            self._enter_routine(elapsed)
        return outcome

    def progress_many(
        self, times: Sequence[int], steps: Sequence[int], recording: Recording
    ) -> Iterator[tuple[int, StateOutcome]]:
        """Progresses all over a recording, as `progress` does state by state.

        Args:
            times: the valid times of the states, in nanoseconds.
            steps: for each state, the nanoseconds since the one before.
            recording: the values of the ground features.

        Returns:
            The states that bring something, by index, and what.
        """
        if self._newcomers and times:
            self.admit(times[0] - steps[0])
        index, states = 0, range(0)
        reader: RecordedSymbols | None = None
        symbols: Sequence[Symbols] | None = None
        while index < len(times) and self._tally:
            if reader is None or not reader.reads(self._singles, self._batches):
                reader = RecordedSymbols(recording, self._singles, self._batches, self._columns)
                states = range(index, index)
            if index == states.stop:
                states = reader.run(index, len(times))
                symbols = reader.symbols(states)
            self._leave_routine()
            if symbols:
                index += self._look_up(symbols, steps, index, states)
                if index == states.stop:
                    continue
                found = symbols[index - states.start]
                outcome = self._step(*found, times[index], steps[index], _NO_FAILURES)
            else:
                outcome = self.progress(times[index], steps[index], values_at(recording, index))
            if outcome:
                yield index, outcome
            index += 1

    def drop(self, formulas: Collection[int], finished: Sequence[FormulaInstance] = ()) -> None:
        """Goes on without some formulas and some instances of others."""
        self._leave_routine()
        gone = set(map(id, finished))
        self._singles = [
            each
            for each in self._singles
            if each.member.formula_id not in formulas and id(each.member) not in gone
        ]
        for batch in self._batches:
            batch.drop(gone, formulas)
        self._batches = [batch for batch in self._batches if len(batch)]
        self._newcomers = [
            each for each in self._newcomers if each.member.formula_id not in formulas
        ]
        self._tally.forget(formulas)
        if any(batch.is_sparse for batch in self._batches):
            self._attach()

    def seats(self, latest: int) -> Iterator[InstanceState]:
        """Where each instance is; `latest` is the valid time of the latest state."""
        self._leave_routine()
        yield from self._seats_taken(latest)
        yield from self._newcomers

    def _seats_taken(self, latest: int) -> Iterator[InstanceState]:
        for single in self._singles:
            yield single.seat(latest)
        for batch in self._batches:
            yield from batch.seats(latest)

    def _seat(self, seats: Sequence[InstanceState], latest: int) -> None:
        self._singles, self._batches = assign_batches(seats, self._singles, self._batches, latest)
        shapes = [single.shape for single in self._singles]
        shapes += [batch.shape for batch in self._batches]
        shapes += [seat.shape for seat in self._newcomers]
        self._shapes = {shape.automaton.initial.node: shape for shape in shapes}
        for seat in seats:
            most = self._node_limit // self._tally.count(seat.member.formula_id)
            seat.shape.harmless = min(seat.shape.harmless, most)
        self._is_large = any(shape.is_large for shape in shapes)
        self._is_plain = False
        self._attach()

    def _attach(self) -> None:
        self._columns = FieldVectors()
        for batch in self._batches:
            batch.attach(self._columns)

    def _read_batches(self, values: Values) -> Sequence[Array]:
        try:
            self._columns.load(values)
        except UnreadableError:
            if not any(batch.loads_too_much for batch in self._batches):
                raise
            self._attach()
            self._columns.load(values)
        return [batch.symbols() for batch in self._batches]

    def _read_one_by_one(
        self, values: Values
    ) -> tuple[list[int], Sequence[Array], Mapping[int, ReasoningError]]:
        """The truth of the atoms; drops the formulas that the values do not suffice for."""
        found: list[tuple[FormulaInstance, ReasoningError]] = []
        singles: dict[int, int] = {}
        for single in self._singles:
            try:
                singles[id(single)] = single.read(values)
            except ReasoningError as error:
                found.append((single.member, error))
        batches: dict[int, Array] = {}
        for batch in self._batches:
            batches[id(batch)], errors = batch.read(values)
            found += errors
        found.sort(key=lambda each: each[0].order, reverse=True)
        failures = {member.formula_id: error for member, error in found}
        if failures:
            for batch in self._batches:
                batches[id(batch)] = batches[id(batch)][batch.without(failures)]
            self.drop(failures)
        symbols = [singles[id(single)] for single in self._singles]
        return symbols, [batches[id(batch)] for batch in self._batches], failures

    def _step(
        self,
        symbols: Sequence[int],
        arrays: Sequence[Array],
        now: int,
        elapsed: int,
        failures: Mapping[int, ReasoningError],
    ) -> StateOutcome | None:
        regular = elapsed == 0 or self._pace.is_regular(elapsed)
        finishes = []
        for single, symbol in zip(self._singles, symbols):  # noqa: B905 - strict costs too much
            finish = single.step(symbol & single.mask, now, elapsed, regular=regular)
            if finish:
                finishes.append(finish)
        for batch, array in zip(self._batches, arrays, strict=True) if arrays else ():
            finishes += batch.step(array, now, elapsed, regular=regular)
        decided = self._take(finishes) if finishes else _NOTHING
        for shape in self._shapes.values():
            if shape.automaton.has_news:
                self._take_news(now)
        if decided.failures:
            failures = {**failures, **decided.failures}
        if self._is_large:
            failures = {**failures, **self._check_sizes(now)}
        self._is_plain = regular and self._takes_look_ups()
        decisions = decided.decisions
        return StateOutcome(decisions, failures) if decisions or failures else None

    def _take(self, finishes: Iterable[InstanceVerdict]) -> StateOutcome:
        outcome, gone = self._tally.take(finishes)
        self.drop([*outcome.decisions, *outcome.failures], gone)
        return outcome

    def _takes_look_ups(self) -> bool:
        """Whether nothing but configurations has to be looked after."""
        by_themselves = bool(self._singles) and not self._batches and not self._is_large
        return by_themselves and all(single.configuration for single in self._singles)

    def _look_up(
        self, symbols: Sequence[Symbols], steps: Sequence[int], begin: int, states: range
    ) -> int:
        """How many states of a recording took no more than a look-up for each instance."""
        if not self._is_plain:
            return 0
        rows = []
        for single in self._singles:
            if single.configuration is None:
                return 0
            rows.append(single.configuration.row(steps[begin]))
        masks = [row.configuration.location.node.mask for row in rows]
        index = begin
        while index < states.stop and steps[index] == steps[begin]:
            found = zip(rows, symbols[index - states.start].singles, masks)  # noqa: B905
            try:
                rows = [row[symbol & mask] for row, symbol, mask in found]
            except KeyError:
                break
            index += 1
        for single, row in zip(self._singles, rows, strict=True):
            single.configuration = row.configuration
        return index - begin

    def _enter_routine(self, elapsed: int) -> None:
        self._plain_in_a_row += 1
        former = self._former_routine
        if former and former.elapsed == elapsed and former.suits(self._singles):
            self.routine = former
        elif self._plain_in_a_row >= _ROUTINE_AFTER and len(self._singles) <= _MOST_IN_A_ROUTINE:
            self.routine = FastPath(self._singles, elapsed)
            self._plain_in_a_row = 0
        if self.routine:
            self.routine.enter()

    def _leave_routine(self) -> None:
        if self.routine:
            self.routine.leave()
            self._former_routine, self.routine = self.routine, None

    def _take_news(self, now: int) -> None:
        """Looks after memory, and the sizes of formulas, when something has been found."""
        for shape in self._shapes.values():
            shape.automaton.has_news = False
            if shape.is_full:
                locations = set()
                for single in self._singles:
                    if single.shape is shape:
                        locations.add(single.leave_configurations(now))
                for batch in self._batches:
                    if batch.shape is shape:
                        locations |= batch.leave_configurations(now)
                shape.forget(locations)
        self._is_large = any(shape.is_large for shape in self._shapes.values())

    def _check_sizes(self, now: int) -> Mapping[int, ReasoningError]:
        """Drops the formulas that have grown beyond the limit."""
        sizes: Counter[int] = Counter()
        for single in self._singles:
            location, _ = single.where(now)
            sizes[single.member.formula_id] += location.node.size
        for batch in self._batches:
            sizes.update(batch.sizes())
        limit = self._node_limit
        failures = {
            formula_id: _too_large(size, limit)
            for formula_id, size in sizes.items()
            if size > limit
        }
        if failures:
            self.drop(failures)
        return failures


def _too_large(size: int, limit: int) -> ReasoningError:
    return ReasoningError(
        f'the formula has grown to {size} nodes, more than {limit}; '
        'bound its intervals, lengthen the sample period, or raise the node limit',
        ExitCode.UNAVAILABLE,
    )
