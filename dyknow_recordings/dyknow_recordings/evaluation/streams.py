"""The streams of a recording, in place of live topics, stream manager and processing engine."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from functools import partial
from itertools import chain
from math import nan
from typing import Final

import numpy as np

from dyknow_common import (
    NO_CONSTRAINTS,
    SECOND_NS,
    Alternatives,
    DyKnowError,
    ExitCode,
    StreamConstraints,
    absence,
    listed_as,
)
from dyknow_configuration import TextSource
from dyknow_coordinator import (
    SILENCE_LIMIT_NS,
    FeatureSource,
    KnownStream,
    KnownStreams,
    field_names,
    stream_topic,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.batches import batch_of, has_alternatives
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.recording import END, RecordedFields, rows_of, unchecked_delay
from dyknow_recordings.reading.trace_recording import TRACE_TOPIC, TRACE_TYPE
from dyknow_stream_processing import (
    ALL,
    SAMPLE_TYPE,
    SILENT_PERIODS,
    STATELESS_UNITS,
    WHOLE,
    BuiltInSource,
    Call,
    Dataflow,
    NeedsStepsError,
    PartialFields,
    Sample,
    SampleBatch,
    Select,
    SourceType,
    StreamError,
    Term,
    Violation,
    ViolationKind,
    WholeMessage,
    free_names,
    ignore,
    joined_reasons,
    load_units,
    nearest_topics,
    parse_specification,
    read_streams,
    subterms,
    total_demand,
    unknown_stream,
)

_ENGINE_FIELDS: Final = ('available_time.sec', 'available_time.nanosec', 'watermark[0].sec')
"""The time at which a sample was made, and what only an engine sets."""


class RecordedStreams:
    """All streams that are made of the topics of a recording.

    Args:
        topics: the recorded topics by absolute name.
        files: in the stream language; each sink in them is a stream.
        fault_of: returns a fault of the messages of a topic; empty if there is none.
        absent_is_unknown: True to take the fields that a message lacks for NaN.
        any_delay: True to take messages however far their stamps are from the clock.
        other_clock: the topics whose stamps are of another clock than the log times.

    Raises:
        StreamError: naming a file that cannot be read or parsed.
    """

    def __init__(
        self,
        topics: Mapping[str, TopicContent],
        files: Iterable[TextSource],
        fault_of: Callable[[str], str] = lambda _: '',
        *,
        absent_is_unknown: bool = False,
        any_delay: bool = False,
        other_clock: AbstractSet[str] = frozenset(),
    ) -> None:
        self._topics = topics
        self._fault_of, self._absent_is_unknown = fault_of, absent_is_unknown
        self._other_clock, self._unchecked = other_clock, set[str]()
        self._units = load_units()
        self._new_dataflow = partial(
            Dataflow.of_any_time if any_delay else Dataflow, self._units, self._source_type
        )
        self._requested = {each.name: each for each in read_streams(files)}
        self.dataflow = self._new_dataflow()
        self._faults: dict[str, str] = {}
        self._consumers: Mapping[str, Collection[str]] = {}
        self._received: dict[str, int] = dict.fromkeys(topics, 0)
        # The log time of the first message of each topic.
        self._first: dict[str, int] = {}
        # The log time of the first message.
        self._begin = END
        self._latest_valid_times: dict[str, int] = {}
        # Why messages of a topic cannot be used.
        self._rejected: dict[str, str] = {}
        self._unstamped: set[str] = set()
        self._kept: dict[str, Callable[[], Sample]] = {}
        # The columns of a trace whose empty cells are unknown values.
        self._optional: AbstractSet[str] = frozenset()
        self.known = self._known_streams()

    @property
    def notes(self) -> tuple[str, ...]:
        """The faults of streams and messages that are no errors."""
        faults = (f"stream '{name}' cannot be made: {text}" for name, text in self._faults.items())
        zero = (
            f"topic '{topic}' leaves stamps at zero: the time of recording is used"
            for topic in sorted(self._unstamped)
        )
        unchecked = map(unchecked_delay, sorted(self._unchecked))
        return (*faults, *zero, *unchecked, *self.dataflow.warnings())

    async def fields(self, name: str) -> tuple[str, ...]:
        """Return the fields of the stream with a name.

        Raises:
            StreamError: NOT_FOUND.
        """
        return self._fields_of(name)

    def source_of_field(self, feature: str, *, is_known: bool) -> FeatureSource | None:
        """Return the source of a feature that is a field of just one recorded topic.

        Args:
            feature: a ground feature.
            is_known: True if it may be a feature of an ontology, and not only a field.

        Raises:
            RecordingError: NOT_FOUND, if it can only be a column of a trace, and is none.
        """
        topics = [name for name, each in self._topics.items() if feature in (each.fields or ())]
        if len(topics) != 1:
            row = self._topics.get(TRACE_TOPIC)
            if row is not None and row.message_type == TRACE_TYPE and not is_known:
                lack = absence('the trace', row.fields or (), feature)
                raise RecordingError(lack, ExitCode.NOT_FOUND)
            return None
        quoted = f'"{feature}"'
        text = str(
            parse_specification(f'stream recorded = select {quoted} as {quoted} from "{topics[0]}"')
        )
        return FeatureSource(feature, 'recorded', text)

    def prepare(
        self, candidates: Iterable[FeatureSource], unknown: Collection[str] = ()
    ) -> Mapping[str, frozenset[str]]:
        """Make the streams that some sources are made of; return the fields that these read.

        The streams run from the beginning of the recording, as under a stream manager.

        Args:
            candidates: the sources.
            unknown: the features that may be unknown: an empty cell of a trace is such a value,
                unless a condition or a stream of a file reads it, too.

        Returns:
            The fields by absolute topic.
        """
        sources = list(candidates)
        origins = {name for source in sources for name in self.known.origins(source)}
        self._make([each for each in self._requested if each in origins])
        self.known = self._known_streams()
        trial = self._new_dataflow()
        for name in self.running(origins):
            specification = parse_specification(self.dataflow.specification(name))
            trial.create(name, specification, NO_CONSTRAINTS)
        required = trial.sources().get(TRACE_TOPIC, frozenset())
        terms = list(_terms_of_topics(sources, unknown, trial))
        self._optional = frozenset() if ALL in required else _optional_cells(terms) - required
        demand: dict[str, set[str]] = defaultdict(set)
        read = (trial.sources(), total_demand(term for _, term in terms))
        for topic, fields in chain.from_iterable(each.items() for each in read):
            demand[self.absolute(topic)] |= fields
        return {
            topic: self._recorded_fields(content, demand[topic])
            for topic, content in self._topics.items()
            if topic in demand and content.fields is not None
        }

    @staticmethod
    def _recorded_fields(content: TopicContent, demand: Collection[str]) -> frozenset[str]:
        if content.message_type == SAMPLE_TYPE:
            demand = {*demand, *_ENGINE_FIELDS}
        fields = content.fields or {}
        found = {each for each in demand if listed_as(fields, each)}
        if WHOLE in demand:
            found.add(WHOLE)
        if ALL in demand:
            found |= {each for each in fields if '[' not in each}
        return frozenset(found)

    def running(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the names of running streams of the files."""
        return tuple(each for each in self.dataflow.names() if each in names)

    def create(
        self,
        name: str,
        specification: str,
        constraints: StreamConstraints,
        on_sample: Callable[[Sample], None],
        on_violation: Callable[[Violation], None] = ignore,
    ) -> None:
        """Create a stream; see `Dataflow.create`."""
        parsed = parse_specification(specification)
        streams = free_names(parsed).streams
        for each in sorted(streams & self._faults.keys()):
            raise StreamError(f"stream '{each}' cannot be made: {self._faults[each]}")
        for each in sorted(streams - {*self.dataflow.names()}):
            raise unknown_stream(each, self.running(self._requested))
        self.dataflow.create(name, parsed, constraints, on_sample, on_violation)
        stated = (each.constraints for each in subterms(self.dataflow.term(name)))
        if any(each.max_delay is not None and not each.reorder for each in stated):
            self._unchecked |= self._other_clock & self.topics(name)
        self._connect()

    def keep(self, names: Collection[str]) -> None:
        """Destroy all streams of files except the named ones."""
        for name in self.running(self._requested):
            if name not in names:
                self.dataflow.destroy(name)
        self._connect()

    def destroy(self, name: str) -> None:
        """Destroy a stream."""
        self.dataflow.destroy(name)
        self._connect()

    def forget(self, topics: AbstractSet[str] | None) -> None:
        """Begin all streams that are made of some topics anew; of any topics if None."""
        names = {name for each in self.dataflow.names() for name in self.dataflow.topics(each)}
        found = {name for name in names if topics is None or self.absolute(name) in topics}
        self.dataflow.forget(found)
        for each in found:
            self._kept.pop(self.absolute(each), None)

    def has_memory(self, name: str) -> bool:
        """Return True if the samples of a stream depend on more than the latest messages."""
        return any(
            self._units.get(each.unit) not in STATELESS_UNITS
            if isinstance(each, Call)
            else isinstance(each, BuiltInSource) and each.window
            for each in subterms(self.dataflow.term(name))
        )

    def reorders(self, name: str) -> bool:
        """Return True if a `max_delay` puts messages in order that a stream is made of."""
        parts = subterms(self.dataflow.term(name))
        is_stated = any(each.constraints.max_delay is not None for each in parts)
        return is_stated and self._other_clock.isdisjoint(self.topics(name))

    def is_regular(self, name: str) -> bool:
        """Return True if a constraint bounds the distance of samples that a stream is made of."""
        parts = subterms(self.dataflow.term(name))
        return any(each.constraints.longest_distance is not None for each in parts)

    def topics(self, name: str) -> AbstractSet[str]:
        """Return the absolute names of the topics that a stream is made of."""
        return set(map(self.absolute, self.dataflow.topics(name)))

    def push(self, recorded: RecordedFields) -> None:
        """Process a message at the time of its recording."""
        topic, now, content = recorded.topic, recorded.log_time, self._topics[recorded.topic]
        self._repeat_kept(now)
        self._received[topic] = now
        self._first.setdefault(topic, now)
        self._begin = min(self._begin, now)
        sample, fault = self._sample_of(recorded), ''
        valid_time = sample.valid_time
        if recorded.message_type != content.message_type:
            fault = 'the type of the topic has changed'
        elif valid_time < 0:
            fault = 'it is stamped with a time before 1970'
        elif valid_time == 0 < now:
            self._unstamped.add(topic)
            valid_time = now
            sample = replace(sample, valid_time=now)
        self._kept.pop(topic, None)
        if content.is_kept and not fault:
            self._kept[topic] = lambda: sample
        if valid_time > self.latest_valid_time(topic):
            self._latest_valid_times[topic] = valid_time
        is_initial = content.is_kept and self._is_initial(topic, valid_time, now)
        for name in self._consumers.get(topic, ()):
            if fault:
                self._reject(name, valid_time, now, fault)
            else:
                is_checked = self._is_checked(recorded)
                self.dataflow.push(name, sample, is_checked=is_checked, is_initial=is_initial)

    def _is_initial(self, topic: str, valid_time: int, now: int) -> bool:
        """Return True if a message was kept until the recorder subscribed to its topic.

        The recorder had subscribed when it received the first message of the topic. The stamp of a
        message only shows that it was not sent earlier, so kept ones must come soon after that.
        """
        first = self._first[topic]
        is_sent = self._topics[topic].has_sent_times
        return valid_time < first and (is_sent or now - first <= SILENCE_LIMIT_NS)

    def _is_checked(self, recorded: RecordedFields) -> bool:
        """Return True if an engine has made a sample, by a clock that is not ahead, as live."""
        values = recorded.values
        if recorded.message_type != SAMPLE_TYPE or not values.keys() >= {*_ENGINE_FIELDS}:
            return False
        made_at = values[_ENGINE_FIELDS[0]] * SECOND_NS + values[_ENGINE_FIELDS[1]]
        return bool(0 < made_at <= recorded.log_time + self.dataflow.max_lead)

    def _repeat_kept(self, now: int) -> None:
        """Give streams that were made since the last message what publishers keep for them."""
        for name in self._repeatable():
            kept = self._kept[self.absolute(name)]()
            self.dataflow.repeat(name, replace(kept, available_time=now))

    def _repeatable(self) -> list[str]:
        """Return the topics with a kept message that a stream lacks."""
        return [each for each in self.dataflow.owed if self.absolute(each) in self._kept]

    def _sample_of(self, recorded: RecordedFields) -> Sample:
        """Return a message as a sample that is valid from its stamp, or else its log time."""
        valid_time = recorded.log_time if recorded.stamp is None else recorded.stamp
        fields, absent = recorded.values, recorded.absent
        rows = {name: each for name, each in fields.items() if isinstance(each, list)}
        optional = self._optional if recorded.message_type == TRACE_TYPE else ()
        unknown = [each for each in absent if self._absent_is_unknown or each in optional]
        if unknown:
            fields = {**fields, **dict.fromkeys(unknown, nan)}
            absent = {name: reason for name, reason in absent.items() if name not in unknown}
        if absent or rows:
            others = {name: each for name, each in fields.items() if name not in rows}
            fields = PartialFields(others, absent, rows)
        if WHOLE in recorded.values:
            fields = WholeMessage(fields, recorded.values[WHOLE])
        return Sample(valid_time, recorded.log_time, fields)

    def _last_of(self, parts: Sequence[MessageColumns]) -> Sample:
        *_, last = rows_of(parts)
        return self._sample_of(last)

    def step_many(
        self, parts: Mapping[str, Sequence[MessageColumns]], end: int
    ) -> Mapping[str, SampleBatch] | None:
        """Process messages by topic until the time of the last one.

        Returns:
            The samples of each stream, with their available times, for which no callback is called;
            None, without an effect, if more happens than samples.
        """
        if self._repeatable():
            return None
        batches = {topic: self._plain_batch(topic, each) for topic, each in parts.items()}
        plain = {topic: each for topic, each in batches.items() if each is not None}
        if len(plain) < len(batches):
            return None
        consumed = {
            name: each for topic, each in plain.items() for name in self._consumers.get(topic, ())
        }
        try:
            found = self.dataflow.step_many(consumed, end)
        except NeedsStepsError:
            return None
        for topic, each in plain.items():
            first = int(each.emission_times()[0])
            self._begin = min(self._begin, first)
            self._first.setdefault(topic, first)
            self._received[topic] = int(each.emission_times()[-1])
            self._latest_valid_times[topic] = int(each.valid_times[-1])
            if len(each) and self._topics[topic].is_kept:
                self._kept[topic] = partial(self._last_of, parts[topic])
        return found

    def _plain_batch(self, topic: str, parts: Sequence[MessageColumns]) -> SampleBatch | None:
        """Return messages that have all fields, and increasing valid times; None for others."""
        content, names = self._topics[topic], parts[0].values.keys()
        for part in parts:
            is_timed = (part.stamps is not None) is (content.has_stamp or content.has_sent_times)
            is_known = part.message_type == content.message_type and is_timed
            if not is_known or part.absent or part.values.keys() != names:
                return None
            if Alternatives.exist and any(map(has_alternatives, part.values.values())):
                return None
        batch = batch_of(parts)
        times = np.append(max(self.latest_valid_time(topic), 0), batch.valid_times)
        return batch if (np.diff(times) > 0).all() else None

    def latest_valid_time(self, topic: str) -> int:
        """Return the latest valid time of the messages of a topic that were processed, or 0."""
        return self._latest_valid_times.get(topic, 0)

    @property
    def latest_receipt(self) -> int:
        """The time at which the latest message was received, in nanoseconds, or 0."""
        return max(self._received.values(), default=0)

    def received_at(self, topic: str) -> int:
        """Return when the latest message of a topic was received, in nanoseconds; or 0."""
        return self._received.get(topic, 0)

    def received(self, name: str) -> dict[str, int]:
        """Return when the latest message of each topic of a stream was received, in ns; or 0."""
        return {topic: self.received_at(topic) for topic in self.topics(name)}

    def waits_for(self, name: str, since: int, span: tuple[int, int] | None = None) -> str:
        """Return why a stream has had no samples since a time.

        Args:
            name: the name of the stream.
            since: in nanoseconds.
            span: the start and end of the recording, in nanoseconds, to judge by the rate of each
                topic whether it has fallen silent; None to name each without a message since then.
        """

        def reason(topic: str) -> str:
            is_due = span is None or self._is_due(self.absolute(topic), *span)
            return self._topic_reason(topic, since if is_due else -1)

        return joined_reasons(self.dataflow.waits_for(name, since, reason))

    def absolute(self, topic: str) -> str:
        """Return the absolute name of a topic."""
        return topic if topic.startswith('/') or topic in self._topics else f'/{topic}'

    def _source_type(self, topic: str) -> SourceType | None:
        content = self._topics.get(self.absolute(topic))
        if content is None:
            return None
        # A topic of samples may be a stream of an engine, such as a merge.
        is_ordered = content.publishers == 1 and content.message_type != SAMPLE_TYPE
        is_sent = content.has_sent_times
        is_received = not (content.has_stamp or is_sent)
        is_other = self.absolute(topic) in self._other_clock
        return SourceType(
            content.fields, is_received, is_ordered, is_sent, content.is_kept, is_other
        )

    def _make(self, names: Sequence[str]) -> None:
        """Make requested streams; one may be made of another that comes later."""
        self._faults = {}
        for name in names:
            specification = parse_specification(self._requested[name].specification)
            try:
                self.dataflow.create(name, specification, NO_CONSTRAINTS)
            except DyKnowError as error:
                self._faults[name] = error.message
        self._connect()
        if 0 < len(self._faults) < len(names):
            self._make(list(self._faults))

    def _known_streams(self) -> KnownStreams:
        made = (
            KnownStream(
                name,
                specification=each.specification,
                topic='' if name in self._faults else self.absolute(stream_topic(name)),
            )
            for name, each in self._requested.items()
        )
        streams = {self.absolute(stream_topic(name)) for name in self._requested}
        return KnownStreams(
            made,
            lambda topic: self.absolute(topic) in streams or self.is_published(topic),
            self.absolute,
            lambda topic: self.received_at(topic) > 0,
        )

    def is_published(self, topic: str) -> bool:
        """Return True if a recorded topic has a publisher by now.

        A recording does not tell when a publisher begins, but with its first message. At its start,
        all may have begun before.
        """
        absolute = self.absolute(topic)
        is_early = self.latest_receipt - self._begin <= SILENCE_LIMIT_NS
        return absolute in self._topics and (is_early or self.received_at(absolute) > 0)

    def _fields_of(self, name: str) -> tuple[str, ...]:
        stream = self._requested.get(name)
        if stream is None:
            raise unknown_stream(name, self._requested)
        return field_names(stream.specification, self._fields_of, self._fields_of_topic)

    def _fields_of_topic(self, topic: str) -> tuple[str, ...]:
        content = self._topics.get(self.absolute(topic))
        return tuple(content.fields or ()) if content else ()

    def _connect(self) -> None:
        consumers = defaultdict(list)
        for topic in self.dataflow.sources():
            consumers[self.absolute(topic)].append(topic)
        self._consumers = consumers

    def _reject(self, name: str, valid_time: int, now: int, fault: str) -> None:
        self._rejected.setdefault(self.absolute(name), fault)
        text = f"stream '{name}': a message cannot be used: {fault}"
        self.dataflow.advance(now)
        self.dataflow.drop(name, ViolationKind.MESSAGE)
        violation = Violation(name, ViolationKind.MESSAGE, valid_time, now, 0, 0, text)
        self.dataflow.report(name, violation)

    def forget_rejected(self) -> None:
        """Forget why messages could not be used of topics that no stream is made of now."""
        found = self._rejected.items()
        self._rejected = {topic: fault for topic, fault in found if topic in self._consumers}

    def _is_due(self, topic: str, start: int, end: int) -> bool:
        """Return True if a topic should have had another message; after a single one, none is."""
        content, latest = self._topics.get(topic), self._received.get(topic, 0)
        if content is None or not content.count or not latest:
            return True
        period = (latest - start) // (content.count - 1) if content.count > 1 else end
        return end - latest > SILENT_PERIODS * period

    def _topic_reason(self, name: str, since: int) -> str:
        topic = self.absolute(name)
        content = self._topics.get(topic)
        if content is None:
            nearest = nearest_topics(topic, self._topics)
            hint = f' (did you mean {" or ".join(nearest)}?)' if nearest else ''
            return f'the recording has no topic {topic}{hint}'
        fault = self._fault_of(topic)
        if content.fields is None or (fault and not self._received[topic]):
            reason = fault or f'the message type {content.message_type} is not defined'
            return f'no message of {topic} can be read: {reason}'
        if not content.count:
            return f'the recording has no message of {topic}'
        if topic in self._rejected:
            return f'messages of {topic} cannot be used: {self._rejected[topic]}'
        return f'{topic} has fallen silent' if self._received[topic] <= since else ''


def _terms_of_topics(
    sources: Iterable[FeatureSource], unknown: Collection[str], trial: Dataflow
) -> Iterator[tuple[bool, Term]]:
    """Make the sources that select from topics; yield them after True for an unknown feature.

    Those that select from streams read no more than these do.
    """
    of_topics = (source for source in sources if source.select is None)
    name = 'a candidate'
    for source in of_topics:
        specification = parse_specification(';\n'.join([*source.units, source.declaration]))
        try:
            trial.create(name, specification, NO_CONSTRAINTS)
        except DyKnowError:
            continue  # It is an error of the formulas that choose it.
        yield source.feature.partition('[')[0] in unknown, trial.term(name)
        # A dataflow of thousands of streams is slow to extend.
        trial.destroy(name)


def _optional_cells(terms: Iterable[tuple[bool, Term]]) -> AbstractSet[str]:
    """Return the fields that sources select, some of unknown features, and test in no condition.

    Args:
        terms: the sources, each after True for a feature that may be unknown.
    """
    optional: set[str] = set()
    required: set[str] = set()
    for may_be_unknown, term in terms:
        for select in (each for each in subterms(term) if isinstance(each, Select)):
            values = {each.field for each in select.selections}
            tests = (*select.conditions, *(each.unless for each in select.selections))
            required |= (select.demand - values) | {each.field for each in tests if each}
            optional |= values if may_be_unknown else set()
    return optional - required
