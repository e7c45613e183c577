"""Streams that run: samples of topics and the time go in, samples and violations come out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from dyknow_common import ExitCode, StreamConstraints, Value, ValueType
from dyknow_stream_processing.dataflow.operator_graph import OperatorGraph
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, Scheduler
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.required_fields import total_demand
from dyknow_stream_processing.language.resolution import Fields, Resolved, resolve
from dyknow_stream_processing.language.specification import Specification
from dyknow_stream_processing.language.type_rules import Unit
from dyknow_stream_processing.sample import Sample
from dyknow_stream_processing.violation import Violation


@dataclass(frozen=True, slots=True)
class SourceType:
    """What is known of a topic.

    Args:
        fields: with their types; `None` if they are not known before samples come.
        receipt_time: whether the valid time of its samples is the time of their receipt.
    """

    fields: Mapping[str, ValueType] | None
    receipt_time: bool


@dataclass(frozen=True, slots=True)
class Statistics:
    """What has come of a stream.

    Args:
        samples: how many it emitted.
        violations: how many it reported, of its own or of what it is made of.
        drops: how many samples were dropped in it and in what it is made of, by reason.
    """

    samples: int
    violations: int
    drops: Mapping[str, int]


class Dataflow:
    """A set of named streams; what several of them have in common is computed once.

    It has no clock and starts no thread. Callbacks must not call back into it.

    Args:
        units: the computational units, by name (see `load_units`).
        source_type: what is known of a topic; `None` if nothing is.
    """

    def __init__(
        self,
        units: Mapping[str, Unit],
        source_type: Callable[[str], SourceType | None],
    ) -> None:
        self._units = units
        self._source_type = source_type
        self._agenda = Scheduler()
        self._wiring = OperatorGraph(self._agenda, units, self._has_receipt_time)
        self._streams: dict[str, _Stream] = {}

    def create(
        self,
        name: str,
        specification: Specification,
        constraints: StreamConstraints,
        on_sample: Callable[[Sample], None],
        on_violation: Callable[[Violation], None],
    ) -> None:
        """Make a stream.

        Args:
            name: what later specifications may refer to it by.
            specification: how it is made.
            constraints: are added to those of the specification.
            on_sample: is given each sample, available times strictly increasing.
            on_violation: is told what is broken in the stream and in all that it is made of.

        Raises:
            StreamError: if there is a stream of that name, the constraints contradict those of the
                specification, or a computational unit cannot be made.
            LanguageError: if the specification makes no sense here.
        """
        if name in self._streams:
            raise StreamError(
                f"there is a stream '{name}' already; destroy it or choose another name",
                ExitCode.ALREADY_EXISTS,
            )
        known = {each.name: each.resolved for each in self._streams.values()}
        resolved = resolve(specification, constraints, known, self._fields_of, self._units)
        try:
            root = self._wiring.connect(resolved.term)
            own_names = {**resolved.names, str(resolved.term): name}
            others = [each.own_names for each in self._streams.values()]
            stream = _Stream(
                name, str(specification), resolved, own_names, self._agenda, on_sample, on_violation
            )
            stream.names = {k: v for names in (*others, own_names) for k, v in names.items()}
            stream.attach(root)
            self._streams[name] = stream
        finally:
            # Had it failed, what was connected before has no use.
            self._wiring.sweep()

    def destroy(self, name: str) -> None:
        """Stop a stream and free what no other stream uses.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        self._find(name).detach()
        del self._streams[name]
        self._wiring.sweep()

    def names(self) -> tuple[str, ...]:
        """The streams, in the order of their creation."""
        return tuple(self._streams)

    def specification(self, name: str) -> str:
        """The canonical text of a stream's specification.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        return self._find(name).specification

    def statistics(self, name: str) -> Statistics:
        """What has come of a stream since its creation.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        return self._find(name).statistics()

    def topics(self, name: str) -> tuple[str, ...]:
        """The topics that a stream is made of, sorted.

        Raises:
            StreamError: NOT_FOUND, naming the streams that there are.
        """
        return self._find(name).topics

    def sources(self) -> Mapping[str, frozenset[str]]:
        """The topics that samples are needed of, each with the fields needed.

        The name `ALL` among them stands for all fields but the elements of arrays.
        """
        return total_demand(each.resolved.term for each in self._streams.values())

    def found(self, topic: str, source_type: SourceType) -> None:
        """Learn of a topic what was not known when streams were made of it."""
        for source in self._wiring.sources.get(topic, ()):
            source.learn(receipt_time=source_type.receipt_time)

    def push(self, topic: str, sample: Sample) -> None:
        """Take a sample of a topic; its available time is the time of receipt, and is now."""
        agenda = self._agenda
        agenda.run(sample.available_time)
        for source in self._wiring.sources.get(topic, ()):
            source.push(sample.valid_time, sample.fields, agenda.now)
        agenda.run(agenda.now)

    def report(self, topic: str, violation: Violation) -> None:
        """Tell all streams made of a topic what was broken on the way here."""
        for source in self._wiring.sources.get(topic, ()):
            for observer in source.observers:
                observer.reported(violation)

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Count samples of a topic that were lost on the way here."""
        for source in self._wiring.sources.get(topic, ()):
            for observer in source.observers:
                observer.dropped(reason, count)

    def restart(self, violation: Violation) -> None:
        """Forget all samples and times: for a clock that has gone back.

        Args:
            violation: is reported by every stream; what was counted so far stays counted.
        """
        self._agenda = Scheduler()
        self._wiring = OperatorGraph(self._agenda, self._units, self._has_receipt_time)
        for stream in self._streams.values():
            stream.restart(self._agenda, self._wiring.connect(stream.resolved.term))
        self._wiring.sweep()
        for stream in self._streams.values():
            stream.reported(violation)

    def advance(self, now: int) -> None:
        """Do what is due until a time, nanoseconds; a time before the last one is ignored."""
        self._agenda.run(now)

    def next_deadline(self) -> int | None:
        """The earliest time at which `advance` has something to do, nanoseconds; or `None`."""
        return self._agenda.next_deadline()

    def _find(self, name: str) -> _Stream:
        if name not in self._streams:
            known = ', '.join(self._streams) or 'none'
            raise StreamError(
                f"there is no stream '{name}' (there are: {known})", ExitCode.NOT_FOUND
            )
        return self._streams[name]

    def _fields_of(self, topic: str) -> Fields | None:
        source = self._source_type(topic)
        return None if source is None else source.fields

    def _has_receipt_time(self, topic: str) -> bool:
        source = self._source_type(topic)
        return source is not None and source.receipt_time


class _Stream:
    """A named stream: consumes what its operator emits, observes all that it is made of."""

    def __init__(
        self,
        name: str,
        specification: str,
        resolved: Resolved,
        own_names: Mapping[str, str],
        agenda: Scheduler,
        on_sample: Callable[[Sample], None],
        on_violation: Callable[[Violation], None],
    ) -> None:
        self.name = name
        self.specification = specification
        self.resolved = resolved
        self.topics = tuple(sorted(total_demand([resolved.term])))
        # Those of others are not kept in `own_names`, or they would be handed down for ever.
        self.own_names = own_names
        self.names = own_names
        self._agenda = agenda
        self._on_sample = on_sample
        self._on_violation = on_violation
        self._operators: list[Operator] = []
        self._available_time = BEGINNING
        self._samples = 0
        self._violations = 0
        self._drops: Counter[str] = Counter()

    def attach(self, root: Operator) -> None:
        """Begin to take the samples of an operator, and to observe it and all before it."""
        root.listeners.append(self)
        pending = [root]
        while pending:
            operator = pending.pop()
            if self not in operator.observers:
                operator.observers.append(self)
                self._operators.append(operator)
                pending.extend(operator.inputs)

    def restart(self, agenda: Scheduler, root: Operator) -> None:
        """Take the samples of another operator, whose times may be before those so far."""
        self._agenda = agenda
        self._available_time = BEGINNING
        self._operators.clear()
        self.attach(root)

    def detach(self) -> None:
        """Take no more samples, and observe no more."""
        root = self._operators[0]
        root.listeners.remove(self)
        for operator in self._operators:
            operator.observers.remove(self)

    def statistics(self) -> Statistics:
        """What has come of it so far."""
        return Statistics(self._samples, self._violations, dict(self._drops))

    def take(self, valid_time: int, fields: Mapping[str, Value]) -> None:
        """Emit a sample; two that come at once are available one after the other."""
        now, earliest = self._agenda.now, self._available_time + 1
        self._available_time = available_time = now if now > earliest else earliest
        self._samples += 1
        self._on_sample(Sample(valid_time, available_time, fields))

    def dropped(self, reason: str, count: int = 1) -> None:
        """Count samples that were dropped."""
        self._drops[reason] += count

    def reported(self, violation: Violation) -> None:
        """Pass on what was broken before the samples came here."""
        self._violations += 1
        self._on_violation(violation)

    def violated(
        self,
        operator: Operator,
        constraint: str,
        valid_time: int,
        message: str,
        observed: int,
        allowed: int,
    ) -> None:
        """Report what was broken."""
        self._violations += 1
        name = self.names.get(operator.label, operator.label)
        self._on_violation(
            Violation(
                stream_name=name,
                constraint=constraint,
                valid_time=valid_time,
                available_time=self._agenda.now,
                observed=observed,
                allowed=allowed,
                message=f"stream '{name}': {message}",
            )
        )
