"""The streams whose samples can be made as columns, from the terms that define them.

These are selections from topics, with conditions and with constraints other than `start_time` and
`end_time`; computational units without a memory over these; and what `sync` and `merge` join of
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import takewhile

from dyknow_common import NO_CONSTRAINTS, StreamConstraints
from dyknow_recordings.evaluation.columns.joined_streams import (
    MergedStream,
    RenamedStream,
    SynchronisedStream,
)
from dyknow_recordings.evaluation.columns.series import ColumnStream
from dyknow_recordings.evaluation.columns.topic_streams import (
    ArrivalLimits,
    FunctionStep,
    SelectionStep,
    TopicStream,
)
from dyknow_stream_processing import (
    STATELESS_UNITS,
    Approximation,
    Call,
    Merge,
    Select,
    Selection,
    StreamReference,
    Sync,
    Term,
    Unit,
    UnitCall,
    references,
)

Step = SelectionStep | FunctionStep


class ColumnTerms:
    """The streams of terms; equal terms are one stream.

    Args:
        units: the computational units by name.
        absolute: returns the absolute name of a topic.
        arrival: returns when the messages of a topic, by its absolute name, arrive.
        max_lead: of topics for which a stream gives none, in nanoseconds.
    """

    def __init__(
        self,
        units: Mapping[str, Unit],
        absolute: Callable[[str], str],
        arrival: Callable[[str], ArrivalLimits],
        max_lead: int,
    ) -> None:
        self._units, self._absolute = units, absolute
        self._arrival, self._max_lead = arrival, max_lead
        self._known: dict[Term, ColumnStream | None] = {}

    def stream(self, term: Term) -> ColumnStream | None:
        """Return the stream of a term; None if its samples cannot be made as columns."""
        if term not in self._known:
            self._known[term] = self._made(term)
        return self._known[term]

    def _made(self, term: Term) -> ColumnStream | None:
        if (steps := self._steps(term)) is not None:
            return self._of_one_topic(term, steps)
        match term:
            case Sync():
                return self._synchronised(term)
            case Merge(constraints=StreamConstraints(is_empty=True)):
                return self._merged(term)
            case Select(constraints=StreamConstraints(is_empty=True), conditions=()):
                return self._renamed(term)
        return None

    def _steps(self, term: Term) -> tuple[Step, ...] | None:
        """Return the steps from a topic to a stream that is made of it alone; None for others."""
        limits = term.constraints
        if limits != _checked(limits):
            return None
        step: Step
        match term:
            case StreamReference():
                return (SelectionStep(None, (), limits),) if term.is_topic else None
            case Select() if (names := _names(term)) is not None:
                step = SelectionStep(names, term.conditions, limits)
            case Call(inputs=(_,)) if self._units.get(term.unit) in STATELESS_UNITS:
                if term.declaration is None:
                    return None
                call = UnitCall(self._units[term.unit], term.declaration, term.arguments)
                step = FunctionStep(call, limits)
            case _:
                return None
        before = self._steps(term.inputs[0])
        return None if before is None else (*before, step)

    def _of_one_topic(self, term: Term, steps: tuple[Step, ...]) -> TopicStream | None:
        if sum(each.constraints.max_delay is not None for each in steps) > 1:
            return None
        topic = self._absolute(next(iter(references(term))).name)
        # Leads are checked when messages arrive, and for a unit's results once more.
        checked = list(takewhile(lambda each: isinstance(each, SelectionStep), steps))
        leads = [each.constraints.max_lead for each in steps]
        given = [each for each in leads if each is not None]
        if all(each is None for each in leads[: len(checked)]):
            given.append(self._max_lead)
        return TopicStream(topic, self._arrival(topic), max_lead=min(given), steps=steps)

    def _inputs(self, term: Sync | Merge) -> list[ColumnStream] | None:
        found = [self.stream(each) for each in term.inputs]
        some = [each for each in found if each is not None and each.fields is not None]
        return some if len(some) == len(found) else None

    def _synchronised(self, term: Sync) -> SynchronisedStream | None:
        limits, inputs = term.constraints, self._inputs(term)
        period, deviation = limits.sample_period, limits.sample_period_deviation
        allowed = StreamConstraints(sample_period=period, sample_period_deviation=deviation)
        if inputs is None or limits != allowed:
            return None
        names = [name for each in inputs for name in each.fields or ()]
        if len(set(names)) < len(names):
            return None
        label = str(replace(term, constraints=NO_CONSTRAINTS))
        is_linear = term.approximation is Approximation.LINEAR
        return SynchronisedStream(inputs, label, period, is_linear=is_linear)

    def _merged(self, term: Merge) -> MergedStream | None:
        inputs = self._inputs(term)
        if inputs is None or len({frozenset(each.fields or ()) for each in inputs}) > 1:
            return None
        return MergedStream(inputs, inputs[0].fields or ())

    def _renamed(self, term: Select) -> RenamedStream | None:
        source, names = self.stream(term.source), _names(term)
        if source is None or names is None or not set(names.values()) <= set(source.fields or ()):
            return None
        return RenamedStream(source, names)


def _checked(limits: StreamConstraints) -> StreamConstraints:
    """Return the constraints that a `TopicStream` checks."""
    return StreamConstraints(
        max_delay=limits.max_delay,
        max_lead=limits.max_lead,
        sample_period=limits.sample_period,
        sample_period_deviation=limits.sample_period_deviation,
        max_gap=limits.max_gap,
        reorder=limits.reorder,
    )


def _names(term: Select) -> Mapping[str, str] | None:
    """Return the selected fields by their new names; None if these depend on values."""
    plain = tuple(Selection(each.field, each.renaming) for each in term.selections)
    # A node that says more than this is left to the dataflow.
    known = Select(plain, term.source, term.conditions, constraints=term.constraints)
    if term != known or any(each.embedded_fields for each in plain):
        return None
    fields = {each.name: each.field for each in term.selections}
    return fields if len(fields) == len(term.selections) else None
