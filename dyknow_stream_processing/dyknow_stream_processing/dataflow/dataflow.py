"""Running streams: samples of topics and the time go in, samples and violations come out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Final, Self

import numpy as np

from dyknow_common import (
    NANOSECONDS,
    ExitCode,
    StreamConstraints,
    Value,
    listed,
    round_duration,
    round_time,
    shortened,
)
from dyknow_stream_processing.dataflow.batches import Refusal, SampleBatch, refuse
from dyknow_stream_processing.dataflow.built_in.topic_rate import RateOperator
from dyknow_stream_processing.dataflow.computational_units import UnitOperator
from dyknow_stream_processing.dataflow.operator_graph import OperatorGraph
from dyknow_stream_processing.dataflow.operators import (
    DEFAULT_DELAYS,
    OTHER_CLOCK_NS,
    UNKNOWN_TYPE,
    DelayLimits,
    Operator,
    SourceType,
)
from dyknow_stream_processing.dataflow.received import Pause
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, Scheduler
from dyknow_stream_processing.errors import StreamError, unknown_stream
from dyknow_stream_processing.language.required_fields import Demand, joined_demands, total_demand
from dyknow_stream_processing.language.resolution import Fields, Resolved, resolve
from dyknow_stream_processing.language.specification import Specification, Term, references
from dyknow_stream_processing.language.type_rules import Unit
from dyknow_stream_processing.sample import Sample
from dyknow_stream_processing.violation import Fault, Violation, ViolationKind

DEFAULT_MAX_LEAD: Final = 100 * NANOSECONDS['ms']
"""The time by which stamps may be ahead of the clock where a stream gives no `max_lead`."""

_MAX_NAME: Final = 80
"""The length of a text that names an operator."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """Counts of emitted samples, reported violations, and dropped samples by reason.

    Violations and drops in the operators and topics that the stream is made of count, too.
    """

    samples: int
    violations: int
    drops: Mapping[str, int]


def ignore(_: object) -> None:
    """Ignore a sample or a violation."""


class Dataflow:
    """A set of named streams; parts that several of them have in common are computed once.

    It has no clock and starts no thread. Callbacks must not call back into it. A method that names
    a stream raises a StreamError (NOT_FOUND, naming the existing streams) if there is none.

    Args:
        units: the computational units, by name (see `load_units`).
        source_type: returns the type of a topic; `None` if it is unknown.
        max_lead: the largest lead of topics for which a stream gives none, in nanoseconds.
        remark: returns the end of a violation's message, given the topics of the stream at fault.
        delays: the delays of topics for which a stream gives no `max_delay`.
    """

    def __init__(
        self,
        units: Mapping[str, Unit],
        source_type: Callable[[str], SourceType | None],
        max_lead: int = DEFAULT_MAX_LEAD,
        remark: Callable[[Iterable[str]], str] = lambda _: '',
        delays: DelayLimits = DEFAULT_DELAYS,
    ) -> None:
        self.max_lead = max_lead
        self.delays = delays
        self._units = units
        self._source_type = source_type
        self._remark = remark
        self._streams: dict[str, _RunningStream] = {}
        self._pauses: dict[str, Pause] = {}
        self._doubted: set[str] = set()
        self._reset()

    @classmethod
    def of_any_time(
        cls, units: Mapping[str, Unit], source_type: Callable[[str], SourceType | None]
    ) -> Self:
        """Return a dataflow that takes samples however far their stamps are from the clock."""
        limits = DelayLimits(OTHER_CLOCK_NS, OTHER_CLOCK_NS)
        return cls(units, source_type, OTHER_CLOCK_NS, delays=limits)

    def _reset(self) -> None:
        self._pauses.clear()
        self._doubted.clear()
        self._scheduler = Scheduler()
        self._graph = OperatorGraph(
            self._scheduler,
            self._units,
            lambda topic: self._source_type(topic) or UNKNOWN_TYPE,
            self.max_lead,
            self.delays,
        )

    def create(
        self,
        name: str,
        specification: Specification,
        constraints: StreamConstraints,
        on_sample: Callable[[Sample], None] = ignore,
        on_violation: Callable[[Violation], None] = ignore,
    ) -> None:
        """Create a stream.

        Args:
            name: the name by which later specifications may refer to it.
            specification: defines the stream.
            constraints: are added to the constraints in the specification.
            on_sample: receives each sample; available times are strictly increasing.
            on_violation: receives the violations in the stream and in all its inputs.

        Raises:
            StreamError: if there is a stream of that name, if the constraints contradict the
                specification, or if a computational unit cannot be instantiated.
            LanguageError: if the specification is not valid here.
        """
        if name in self._streams:
            message = f"there is a stream '{name}' already; destroy it or choose another name"
            raise StreamError(message, ExitCode.ALREADY_EXISTS)
        others = self._streams.values()
        known = {each.name: each.resolved for each in others}
        resolved = resolve(specification, constraints, known, self._fields_of, self._units)
        names = {label: name for each in others for label, name in each.own_names.items()}
        text, scheduler = str(specification), self._scheduler
        stream = _RunningStream(
            name, text, resolved, names, scheduler, self._remarks, on_sample, on_violation
        )
        try:
            stream.attach(self._graph.connect(resolved.term))
            self._streams[name] = stream
            self._doubt_new(stream)
        finally:
            # If it failed, the operators that were connected before are unused.
            self._graph.sweep()

    def _remarks(self, topics: Iterable[str], fault: Fault) -> str:
        """Return the end of a violation's message, given the topics of the operator at fault."""
        text = self._remark(topics)
        begin = fault.valid_time - fault.allowed
        for topic in () if fault.constraint == ViolationKind.LOST else topics:
            pause = self._pauses.get(topic)
            if pause is not None and begin <= pause.settled:
                length = round_duration(pause.ended - pause.began)
                end = round_time(pause.ended)
                return f'{text}; the node that reads {topic} did not run for {length} until {end}'
        return text

    def _doubt_new(self, stream: _RunningStream) -> None:
        for each in stream.operators:
            if isinstance(each, RateOperator) and each.emitted_at is None:
                for topic in self._doubted & {source.label for source in each.sources}:
                    each.doubt(self._pauses[topic].settled)

    def complete_windows(self, name: str) -> None:
        """Give no results of windows that have not passed since their first sample.

        For a stream that another engine made before, of messages that are unknown here.
        """
        for each in self._find(name).operators:
            if isinstance(each, UnitOperator):
                each.complete_window()

    def destroy(self, name: str) -> None:
        """Stop a stream and free the operators that no other stream uses."""
        stream = self._find(name)
        stream.detach()
        del self._streams[name]
        self._graph.sweep(stream.operators)
        # A new subscription receives what is sent from now on.
        self._doubted &= self._graph.sources.keys()

    def names(self) -> tuple[str, ...]:
        """Return the streams, in the order of their creation."""
        return tuple(self._streams)

    def specification(self, name: str) -> str:
        """Return the canonical text of a stream's specification."""
        return self._find(name).specification

    def term(self, name: str) -> Term:
        """Return what a stream computes, down to the topics that it is made of."""
        return self._find(name).resolved.term

    def fields(self, name: str) -> Fields | None:
        """Return the fields of a stream; `None` if they are not known before samples arrive."""
        return self._find(name).resolved.fields

    def count_drop(self, name: str, reason: str) -> None:
        """Count a sample of a stream that its receiver could not use."""
        self._find(name).count_drops(reason)

    def statistics(self, name: str) -> Statistics:
        """Return the counts of a stream."""
        stream = self._find(name)
        return Statistics(stream.samples, stream.violations, dict(stream.drops))

    def waits_for(
        self, name: str, since: int, topic_reason: Callable[[str], str]
    ) -> tuple[str, ...]:
        """Return why a stream that has no samples has none; see `waiting_reasons`."""
        stream = self._find(name)
        root = stream.operators[0]
        return tuple(dict.fromkeys(waiting_reasons(root, since, topic_reason, stream.name_of)))

    def warnings(self) -> tuple[str, ...]:
        """Return the warnings of all units, each with the first stream that is made by it."""
        found: dict[str, str] = {}
        for stream in self._streams.values():
            for each in stream.operators:
                if isinstance(each, UnitOperator) and each.call.warning:
                    found.setdefault(each.call.warning, stream.name)
        return tuple(f"stream '{name}': {warning}" for warning, name in found.items())

    def topics(self, name: str) -> tuple[str, ...]:
        """Return the topics that a stream is made of, sorted."""
        return self._find(name).topics

    def sources(self) -> Mapping[str, frozenset[str]]:
        """Return the topics whose samples are needed, each with the needed fields.

        The name `ALL` among them stands for all fields except the elements of arrays, the name
        `WHOLE` for the message itself, pushed as a `WholeMessage`.
        """
        demands = (each.demand.items() for each in self._streams.values())
        return joined_demands(chain.from_iterable(demands))

    def set_source_type(self, topic: str, source_type: SourceType) -> None:
        """Set the type of a topic that was unknown or has changed since streams were created."""
        for source in self._graph.sources.get(topic, ()):
            source.set_type(source_type)

    def push(
        self, topic: str, sample: Sample, *, is_checked: bool = False, is_initial: bool = False
    ) -> None:
        """Process a sample of a topic.

        Args:
            topic: its name.
            sample: its available time is the time of receipt, and is now. With a watermark, it is
                one of a stream that another engine vouches for.
            is_checked: True if another engine has checked its stamps: it may then be further ahead
                of the clock than `max_lead`, unless a stream gives a `max_lead` by itself.
            is_initial: True if it was sent before the topic was subscribed to: a publisher keeps
                it for late subscribers. It is the value since its stamp, and never late.
        """
        valid_time, fields, watermark = sample.valid_time, sample.fields, sample.watermark
        scheduler = self._scheduler
        scheduler.run(sample.available_time)
        for source in self._graph.sources.get(topic, ()):
            source.push(valid_time, fields, scheduler.now, is_checked, watermark, is_initial)
        scheduler.run(scheduler.now)

    @property
    def owed(self) -> frozenset[str]:
        """The topics whose kept value a new stream still lacks; see `repeat`."""
        return self._graph.owed

    def repeat(self, topic: str, sample: Sample) -> None:
        """Give the latest kept value to the streams that were made after it came.

        Args:
            topic: its name.
            sample: its available time is now; it is treated as initial, see `push`.
        """
        scheduler = self._scheduler
        scheduler.run(sample.available_time)
        for source in self._graph.sources.get(topic, ()):
            if source.is_owed and source.emitted_at is None:
                source.push(sample.valid_time, sample.fields, scheduler.now, False, None, True)
        scheduler.run(scheduler.now)

    def step_many(self, messages: Mapping[str, SampleBatch], end: int) -> Mapping[str, SampleBatch]:
        """Process messages as columns, and the time until the last one, as `push` would.

        Args:
            messages: the messages by topic, in the order of their receipt.
            end: the time of receipt of the last message, in nanoseconds.

        Returns:
            The samples of each stream, with their available times; callbacks receive none.

        Raises:
            NeedsStepsError: if an operator refuses, as `push` would do more than pass samples on.
                Nothing has changed.
        """
        for each in messages.values():
            if each.receipts is not None and (each.receipts < self._scheduler.now).any():
                refuse(Refusal.ORDER)
        found = self._graph.step_many(messages, end)
        self._scheduler.run(end)
        streams = self._streams.items()
        return {name: each.receive_many(found[each.operators[0]]) for name, each in streams}

    def vouch(self, topic: str, watermark: int, now: int) -> None:
        """Process a watermark of another engine's stream that came without a sample.

        From the first watermark of a topic on, the clock makes no value of it certain.

        Args:
            topic: its name.
            watermark: the time, in nanoseconds, before which no later sample is valid.
            now: the time of receipt.
        """
        scheduler = self._scheduler
        scheduler.run(now)
        for source in self._graph.sources.get(topic, ()):
            source.vouch(watermark, scheduler.now)
        scheduler.run(scheduler.now)

    def watermark(self, name: str) -> int:
        """Return the valid time until which a stream has delivered all of its samples.

        The streams of the dataflow must have processed all samples that were received until the
        time that was last passed to `advance`.
        """
        return self._find(name).operators[0].certain_until(self._scheduler.now)

    def report(self, topic: str, violation: Violation) -> None:
        """Report a violation to all streams made of a topic."""
        for source in self._graph.sources.get(topic, ()):
            for observer in source.observers:
                observer.report(violation)

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Count samples of a topic that were lost before they arrived here."""
        for source in self._graph.sources.get(topic, ()):
            for observer in source.observers:
                observer.count_drops(reason, count)

    def doubt(self, topic: str, pause: Pause) -> None:
        """Make no rate of a topic certain by the clock, as this process has paused.

        Until `trust`, rates wait for the windows that begin before the end of the pause.
        """
        self._pauses[topic] = pause
        self._doubted.add(topic)
        for each in self._rates(topic):
            each.doubt(pause.settled)

    def lose(self, topic: str, violation: Violation | None = None) -> None:
        """Process that messages of a doubted topic are lost before the next one.

        Args:
            topic: its name.
            violation: is reported by all streams but rates, which find their own.
        """
        rates = self._rates(topic)
        for each in rates:
            each.lose()
        informed = {observer for each in rates for observer in each.observers}
        if violation is None:
            return
        for source in self._graph.sources.get(topic, ()):
            for observer in source.observers:
                if observer not in informed:
                    observer.report(violation)

    def trust(self, topic: str) -> None:
        """End the doubt about a topic with its next message: all lost ones were told by `lose`."""
        self._doubted.discard(topic)
        for each in self._rates(topic):
            each.trust()

    def _rates(self, topic: str) -> list[RateOperator]:
        sources = {*self._graph.sources.get(topic, ())}
        rates = self._graph.operators(RateOperator)
        return [each for each in rates if not sources.isdisjoint(each.sources)]

    def dropped(self, topic: str) -> Counter[str]:
        """Return how many samples the operators of a topic alone have dropped, by reason."""
        return sum((each.dropped for each in self._graph.sources.get(topic, ())), Counter[str]())

    def restart(self, violation: Violation) -> None:
        """Discard all samples and times, after the clock has jumped back.

        Args:
            violation: is reported by every stream; the statistics are kept.
        """
        self._reset()
        for stream in self._streams.values():
            stream.restart(self._scheduler, self._graph.connect(stream.resolved.term))
        self._graph.sweep()
        for stream in self._streams.values():
            stream.report(violation)

    def forget(self, topics: AbstractSet[str]) -> None:
        """Restart all streams that are made of some topics, as messages of the topics are missing.

        Periodic ticks stay where they are.
        """
        ticks = self._graph.ticks()
        found = [each for each in self._streams.values() if not topics.isdisjoint(each.topics)]
        for each in found:
            each.detach()
        self._graph.sweep(operator for each in found for operator in each.operators)
        for each in found:
            each.operators.clear()
            each.attach(self._graph.connect(each.resolved.term))
        self._graph.set_ticks(ticks)
        self._graph.sweep()

    def advance(self, now: int) -> None:
        """Do the work that is due until a time, nanoseconds; an earlier time is ignored."""
        self._scheduler.run(now)

    def next_deadline(self) -> int | None:
        """Return the earliest time at which `advance` has work to do, nanoseconds; or `None`."""
        return self._scheduler.next_deadline()

    def _find(self, name: str) -> _RunningStream:
        if name not in self._streams:
            raise unknown_stream(name, self._streams)
        return self._streams[name]

    def _fields_of(self, topic: str) -> Fields | None:
        source = self._source_type(topic)
        return None if source is None else source.fields


@dataclass(eq=False)
class _RunningStream:
    """A named stream: listens to the last of its operators, and observes all of them.

    Args:
        names: the names that other streams give to operators, by the labels of the operators; the
            names of this stream take precedence.
    """

    name: str
    specification: str
    resolved: Resolved
    names: Mapping[str, str]
    scheduler: Scheduler
    remarks: Callable[[Iterable[str], Fault], str]
    on_sample: Callable[[Sample], None]
    on_violation: Callable[[Violation], None]
    samples: int = 0
    violations: int = 0
    drops: Counter[str] = field(default_factory=Counter)
    available_time: int = BEGINNING
    operators: list[Operator] = field(default_factory=list)

    @cached_property
    def own_names(self) -> Mapping[str, str]:
        # Names of other streams are left out, as they would accumulate from stream to stream.
        return {**self.resolved.names, str(self.resolved.term): self.name}

    @cached_property
    def demand(self) -> Mapping[str, Demand]:
        """The fields of each topic that it needs."""
        return total_demand([self.resolved.term])

    @cached_property
    def topics(self) -> tuple[str, ...]:
        return tuple(sorted({each.name for each in references(self.resolved.term)}))

    def name_of(self, label: str) -> str:
        """Return the name of the stream that the label of an operator states, or the label."""
        return self.own_names.get(label) or self.names.get(label, label)

    def attach(self, root: Operator) -> None:
        """Listen to an operator, and observe it and all operators before it."""
        root.listeners.append(self)
        pending = [root]
        while pending:
            operator = pending.pop()
            if self not in operator.observers:
                operator.observers.append(self)
                self.operators.append(operator)
                pending.extend(operator.inputs)

    def restart(self, scheduler: Scheduler, root: Operator) -> None:
        """Listen to another operator; its times may be earlier than the times so far."""
        self.scheduler = scheduler
        self.available_time = BEGINNING
        self.operators.clear()
        self.attach(root)

    def detach(self) -> None:
        self.operators[0].listeners.remove(self)
        for operator in self.operators:
            operator.observers.remove(self)

    def receive(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        # Simultaneous samples become available a nanosecond apart.
        now, earliest = self.scheduler.now, self.available_time + 1
        self.available_time = available_time = now if now > earliest else earliest
        self.samples += 1
        self.on_sample(Sample(valid_time, available_time, fields, watermark))

    def receive_many(self, batch: SampleBatch) -> SampleBatch:
        """Count samples; return them with their available times."""
        if not len(batch):
            return batch
        # Those that are emitted at the same time become available a nanosecond apart.
        steps = np.arange(len(batch))
        times = np.maximum(batch.emission_times() - steps, self.available_time + 1)
        available = np.maximum.accumulate(times) + steps
        self.samples += len(batch)
        self.available_time = int(available[-1])
        return replace(batch, receipts=available)

    def count_drops(self, reason: str, count: int = 1) -> None:
        self.drops[reason] += count

    def report(self, violation: Violation) -> None:
        self.violations += 1
        self.on_violation(violation)

    def report_fault(self, operator: Operator, fault: Fault) -> None:
        name = self.name_of(operator.label)
        end = self.remarks(_topics_of(operator), fault)
        self.report(
            Violation(
                stream_name=name,
                constraint=fault.constraint,
                valid_time=fault.valid_time,
                available_time=self.scheduler.now,
                observed=fault.observed,
                allowed=fault.allowed,
                message=f"stream '{name}': {fault.message}{end}",
            )
        )


def _topics_of(operator: Operator) -> dict[str, None]:
    """Return the topics that an operator's samples are made of, in the order of its inputs."""
    return dict.fromkeys(each.label for each in operator.sources)


def waiting_reasons(
    operator: Operator,
    since: int,
    topic_reason: Callable[[str], str],
    name_of: Callable[[str], str],
) -> Iterator[str]:
    """Yield why an operator emits no samples, if it emits none: what its operators wait for.

    Example: in `sync("/a", (select x from "/b" where x > 9), "/c")`, only /b has delivered, with
    x = 1. The `sync` waits for /a and /c, so their reasons are yielded, such as `nobody publishes
    /a`. Once /a and /c deliver, the `sync` waits for the `select`. The input of the `select`
    delivers samples, but the `select` emits none. So the reason is the `select` itself: `no sample
    of /b satisfies x > 9`.

    Args:
        operator: is taken to emit none.
        since: samples before this time, nanoseconds, do not count.
        topic_reason: returns why a topic has no messages; empty if it needs none.
        name_of: returns the name of the stream that the label of an operator states.
    """

    def name(each: Operator) -> str:
        return shortened(name_of(each.label), _MAX_NAME)

    if not operator.inputs:
        if reason := topic_reason(operator.label):
            yield reason
        return
    silent = [each for each in operator.awaited() if not _delivers(each, operator, since)]
    found = [
        reason for each in silent for reason in waiting_reasons(each, since, topic_reason, name_of)
    ]
    if not found:  # A topic whose publishers keep their messages may be silent.
        delay = operator.delay(lambda each: listed(_topics_of(each)))
        found = [delay or ('' if silent else operator.obstacle(name))]
    yield from filter(None, found)


def _delivers(source: Operator, consumer: Operator, since: int) -> bool:
    """Return True if an operator has emitted a sample since then, and after the consumer's last."""
    if source.emitted_at is None or source.emitted_at <= since:
        return False
    return consumer.emitted_at is None or source.emitted_at > consumer.emitted_at
