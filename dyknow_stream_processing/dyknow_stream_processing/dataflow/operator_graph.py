"""Construction of operators from resolved streams; equal parts share one operator."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar, cast

from dyknow_common import NO_CONSTRAINTS, StreamConstraints
from dyknow_stream_processing.dataflow.batches import (
    NO_SAMPLES,
    Planned,
    SampleBatch,
    later_than,
)
from dyknow_stream_processing.dataflow.built_in.action_status import ActionStatusOperator
from dyknow_stream_processing.dataflow.built_in.frames import (
    FramesOperator,
    TransformTreeOperator,
)
from dyknow_stream_processing.dataflow.built_in.topic_rate import RateOperator
from dyknow_stream_processing.dataflow.computational_units import UnitOperator
from dyknow_stream_processing.dataflow.constraint_checks import (
    ArrivalOperator,
    BoundsOperator,
    LeadOperator,
    OrderOperator,
    ReorderOperator,
)
from dyknow_stream_processing.dataflow.distances import DistanceOperator, Distances, ExpiryOperator
from dyknow_stream_processing.dataflow.operators import (
    DelayLimits,
    MergeOperator,
    Operator,
    SourceOperator,
    SourceType,
    Wiring,
)
from dyknow_stream_processing.dataflow.scheduler import Scheduler
from dyknow_stream_processing.dataflow.selection import ElementsOperator, SelectOperator
from dyknow_stream_processing.dataflow.synchronisation import (
    LinearSyncOperator,
    SyncOperator,
    TickKey,
)
from dyknow_stream_processing.language.built_in_sources import TF_STATIC
from dyknow_stream_processing.language.specification import (
    Approximation,
    BuiltIn,
    BuiltInSource,
    Call,
    Merge,
    Select,
    StreamReference,
    Sync,
    Term,
    references,
)
from dyknow_stream_processing.language.type_rules import Unit

OperatorT = TypeVar('OperatorT', bound=Operator)


@dataclass(frozen=True, slots=True)
class _ArrivalChecks:
    """The checks of samples when they arrive: a select or a merge passes them on to its topics.

    Args:
        max_lead: the least one, in nanoseconds.
        reorder: as the innermost stream states it.
    """

    max_lead: int | None = None
    reorder: bool | None = None

    def within(self, constraints: StreamConstraints) -> _ArrivalChecks:
        """Return the checks for the inputs of a stream with these constraints."""
        leads = [each for each in (constraints.max_lead, self.max_lead) if each is not None]
        reorder = self.reorder if constraints.reorder is None else constraints.reorder
        return _ArrivalChecks(min(leads, default=None), reorder)


class OperatorGraph:
    """The running operators; each is kept as long as an operator or a stream uses its samples."""

    def __init__(
        self,
        scheduler: Scheduler,
        units: Mapping[str, Unit],
        source_type: Callable[[str], SourceType],
        max_lead: int,
        delays: DelayLimits,
    ) -> None:
        self._scheduler = scheduler
        self._units = units
        self._source_type = source_type
        self._max_lead = max_lead
        self._delays = delays
        self._operators: dict[Hashable, Operator] = {}
        self._keys: dict[Operator, Hashable] = {}
        self._new: list[Operator] = []
        self._owed: set[SourceOperator] = set()
        self.sources: dict[str, tuple[SourceOperator, ...]] = {}
        """The source operators of each topic."""

    def connect(self, term: Term) -> Operator:
        """Return the operator that emits a stream; attach a listener before the next `sweep`.

        Raises:
            StreamError: if a computational unit cannot be instantiated.
        """
        return self._constrained(term, may_be_late=False)

    def sweep(self, former: Iterable[Operator] = ()) -> None:
        """Remove every operator whose samples are not used, of some and of the new ones."""
        some = {*former, *self._new}
        self._new.clear()
        for operator in sorted(some, key=lambda each: each.rank, reverse=True):
            if not operator.consumers and not operator.listeners:
                del self._operators[self._keys.pop(operator)]
                self._scheduler.forget(operator)
                for each in operator.inputs:
                    each.consumers = [entry for entry in each.consumers if entry[0] is not operator]
                if isinstance(operator, SourceOperator):
                    sources = self.sources.pop(operator.label)
                    if others := tuple(each for each in sources if each is not operator):
                        self.sources[operator.label] = others

    @property
    def owed(self) -> frozenset[str]:
        """The topics with an operator that lacks a kept value which former ones have received."""
        # Asked for with each message of a recording, so not of all operators.
        self._owed = {each for each in self._owed if each.emitted_at is None and each in self._keys}
        return frozenset(each.label for each in self._owed)

    def ticks(self) -> Mapping[TickKey, int]:
        """Return the next tick of each periodic `sync` that has begun."""
        found = [(each.tick_key, each.next_tick) for each in self.operators(SyncOperator)]
        return {key: tick for key, tick in found if key is not None and tick is not None}

    def set_ticks(self, ticks: Mapping[TickKey, int]) -> None:
        """Set the next tick of each periodic `sync` that has one here."""
        for each in self.operators(SyncOperator):
            if each.tick_key is not None:
                each.next_tick = ticks.get(each.tick_key)

    def step_many(
        self, messages: Mapping[str, SampleBatch], end: int
    ) -> Mapping[Operator, SampleBatch]:
        """Process messages of topics, as columns, and the time until `end`.

        Returns:
            The samples of each operator.

        Raises:
            NeedsStepsError: if an operator refuses; nothing has changed.
        """
        before = [(each, each.watermark) for each in self._operators.values()]
        before.sort(key=lambda pair: pair[0].rank)
        plans: dict[Operator, Planned] = {}
        try:
            for each, watermark in before:
                inputs = [plans[source].output for source in each.inputs]
                plan = each.step_many(inputs or [messages.get(each.label, NO_SAMPLES)], end)
                # Its consumers plan with the watermark to come.
                each.watermark = max(watermark, plan.watermark)
                settled = later_than(watermark, plan.output.settled)
                plans[each] = replace(plan, output=replace(plan.output, settled=settled))
        except BaseException:
            for each, watermark in before:
                each.watermark = watermark
            raise
        for each, plan in plans.items():
            plan.adopt()
            for latest in plan.output.rows(slice(-1, None)).emission_times():
                each.emitted_at = int(latest)
        return {each: plan.output for each, plan in plans.items()}

    def operators(self, kind: type[OperatorT]) -> list[OperatorT]:
        """Return the running operators of a kind."""
        return [each for each in self._operators.values() if isinstance(each, kind)]

    def _constrained(
        self, term: Term, *, may_be_late: bool, arrival: _ArrivalChecks = _ArrivalChecks()
    ) -> Operator:
        """Return the operator of a term with its constraints.

        With `may_be_late`, it may emit samples out of order, as a consumer reorders them. Otherwise
        samples of a topic that are older than their predecessors are dropped.
        """
        label, demands = _label(term), term.constraints
        arrival = arrival.within(demands)
        if isinstance(term, BuiltInSource) and term.kind is BuiltIn.RATE:
            demands = replace(demands, max_delay=None)  # It is the topic's.
        elif not arrival.reorder and self._has_other_clock(term):
            demands = replace(demands, max_delay=None)  # No delay follows from the stamps.
        is_delayed, is_regular = demands.max_delay is not None, demands.longest_distance is not None
        is_sorted = is_delayed or (may_be_late and not is_regular)
        operator = self._bare(term, may_be_late=is_sorted, arrival=arrival)
        if isinstance(term, Sync | Call) and arrival.max_lead is not None:
            operator = self._operator(LeadOperator, label, [operator], arrival.max_lead, False)
        if is_delayed:
            limits = (demands.max_delay, demands.shortest_period)
            operator = self._operator(ReorderOperator, label, [operator], *limits)
        elif is_regular:
            operator = self._in_order(operator)
        bounds = (demands.start_time, demands.end_time)
        if bounds != (None, None):
            operator = self._operator(BoundsOperator, label, [operator], *bounds)
        # A sync keeps its period by itself, unless a `max_delay` makes it drop late ticks.
        is_periodic = isinstance(term, Sync) and demands.max_delay is None
        if demands.sample_period is not None and not is_periodic:
            allowed = Distances.of_period(demands)
            operator = self._operator(DistanceOperator, label, [operator], allowed)
        if demands.max_gap is not None:
            allowed = Distances.of_gap(demands)
            if demands.expires and isinstance(term, Select):
                names = tuple(each.name for each in term.selections)
                return self._operator(ExpiryOperator, label, [operator], allowed, names)
            operator = self._operator(DistanceOperator, label, [operator], allowed)
        return operator

    def _bare(self, term: Term, *, may_be_late: bool, arrival: _ArrivalChecks) -> Operator:
        label = _label(replace(term, constraints=NO_CONSTRAINTS))
        match term:
            case StreamReference():
                return self._topic(term.name, label, may_be_late=may_be_late, arrival=arrival)
            case BuiltInSource():
                return self._built_in(term, label, may_be_late=may_be_late, arrival=arrival)
            case Select():
                source = self._constrained(term.source, may_be_late=may_be_late, arrival=arrival)
                if term.elements is not None:
                    source = self._operator(ElementsOperator, source.label, [source], *term.demand)
                return self._selected(source, label, (term.selections, term.conditions))
            case Merge():
                inputs = [
                    self._constrained(each, may_be_late=may_be_late, arrival=arrival)
                    for each in term.inputs
                ]
                return self._operator(MergeOperator, label, inputs)
            case Sync():
                inputs = self._sorted(term.inputs)
                ticks = (term.constraints.start_time, term.constraints.sample_period)
                return self._operator(_SYNCS[term.approximation], label, inputs, *ticks)
            case Call():
                inputs = self._sorted(term.inputs)
                details = (self._units[term.unit], term.declaration, term.arguments)
                return self._operator(UnitOperator, label, inputs, *details)

    def _has_other_clock(self, term: Term) -> bool:
        return any(self._source_type(each.name).other_clock for each in references(term))

    def _topic(
        self, name: str, label: str, *, may_be_late: bool, arrival: _ArrivalChecks
    ) -> Operator:
        type_ = self._source_type(name)
        source = self._source(label, type_)
        # Streams share the operator, including streams made before the type was known.
        source.set_type(type_)
        max_lead = arrival.max_lead
        limit = (self._max_lead, True) if max_lead is None else (max_lead, False)
        if may_be_late:
            return self._operator(ArrivalOperator, label, [source], *limit, arrival.reorder)
        return self._operator(OrderOperator, label, [source], *limit, self._delays)

    def _source(self, label: str, type_: SourceType) -> SourceOperator:
        """Return the operator of a topic; a new one if a kept value has passed the former ones."""
        key = _key(SourceOperator, label, [], type_.receipt_time)
        former = self._operators.get(key)
        if type_.is_kept and former is not None and former.emitted_at is not None:
            self._keys[former] = key, id(former)
            self._operators[self._keys[former]] = self._operators.pop(key)
        has_passed = any(each.emitted_at is not None for each in self.sources.get(label, ()))
        operator = self._operator(SourceOperator, label, [], type_.receipt_time)
        source = cast('SourceOperator', operator)
        if type_.is_kept and has_passed:
            source.is_owed = True
            self._owed.add(source)
        return source

    def _built_in(
        self, term: BuiltInSource, label: str, *, may_be_late: bool, arrival: _ArrivalChecks
    ) -> Operator:
        topic = term.inputs[0]
        if term.kind is BuiltIn.RATE:
            # The clock must be able to say that no message has come.
            delay = term.constraints.max_delay or self._delays.stamped
            # Nothing but a delay tells when a window is complete, also if it is not known.
            constraints = StreamConstraints(
                max_delay=delay, reorder=True if self._has_other_clock(topic) else None
            )
            delayed = replace(topic, constraints=constraints)
            source = self._constrained(delayed, may_be_late=False, arrival=arrival)
            return self._operator(RateOperator, label, [source], term.window)
        if term.kind is BuiltIn.ACTION:
            source = self._bare(topic, may_be_late=False, arrival=arrival)
            return self._operator(ActionStatusOperator, label, [source])
        topics = (_label(topic), TF_STATIC)
        # Their valid times are not used, so there is one tree, whether the type is known or not.
        sources = [self._operator(SourceOperator, each, [], True) for each in topics]
        tree = self._operator(TransformTreeOperator, topics[0], sources)
        max_delay = None if may_be_late else self._delays.stamped
        frames = self._operator(FramesOperator, label, [tree], *term.arguments, max_delay)
        limit = self._max_lead if arrival.max_lead is None else arrival.max_lead
        return self._operator(LeadOperator, label, [frames], limit, False)

    def _selected(self, source: Operator, label: str, details: tuple[object, ...]) -> Operator:
        if isinstance(source, LeadOperator) and not isinstance(source, OrderOperator):
            # A stream is not at fault for samples that it does not select.
            selected = self._selected(source.inputs[0], label, details)
            return self._operator(type(source), label, [selected], *source.limit)
        if not isinstance(source, MergeOperator):
            return self._operator(SelectOperator, label, [source], *details)
        # Selecting before merging is equivalent, and keeps the separate promises of the inputs.
        inputs = [self._selected(each, label, details) for each in source.inputs]
        return self._operator(MergeOperator, label, inputs)

    def _sorted(self, terms: Iterable[Term]) -> list[Operator]:
        return [self._in_order(self._constrained(each, may_be_late=False)) for each in terms]

    def _in_order(self, operator: Operator) -> Operator:
        if operator.in_order:
            return operator
        return self._operator(ReorderOperator, operator.label, [operator])

    def _operator(
        self,
        kind: Callable[..., Operator],
        label: str,
        inputs: Sequence[Operator],
        *details: object,
    ) -> Operator:
        key = _key(kind, label, inputs, *details)
        if key not in self._operators:
            wiring = Wiring(self._scheduler, label, tuple(inputs))
            operator = self._operators[key] = kind(wiring, *details)
            self._keys[operator] = key
            self._new.append(operator)
            if isinstance(operator, SourceOperator):
                self.sources[label] = (*self.sources.get(label, ()), operator)
            for port, each in enumerate(inputs):
                each.consumers.append((operator, port))
        return self._operators[key]


_SYNCS: Final = {
    Approximation.LATEST: SyncOperator,
    Approximation.LINEAR: LinearSyncOperator,
}


def _key(
    kind: Callable[..., Operator], label: str, inputs: Sequence[Operator], *details: object
) -> Hashable:
    return kind, label, tuple(map(id, inputs)), details


def _label(term: Term) -> str:
    return term.name if isinstance(term, StreamReference) else str(term)
