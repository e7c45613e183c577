"""Topics as sources of a dataflow: subscriptions that follow its needs."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import SECOND_NS, Value, round_duration, round_time
from dyknow_common.ros import Throttle, time_to_nanoseconds
from dyknow_stream_processing.dataflow.dataflow import Dataflow
from dyknow_stream_processing.dataflow.operators import SourceType
from dyknow_stream_processing.dataflow.received import Pause
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.required_fields import WHOLE, Demand
from dyknow_stream_processing.reporting.sender_clock import CLOCK_TOLERANCE_NS, SenderClock
from dyknow_stream_processing.reporting.silence import last_sign, topic_reason
from dyknow_stream_processing.reporting.stream_report import SourceReport
from dyknow_stream_processing.ros.messages.conversions import extractor
from dyknow_stream_processing.ros.messages.message_types import (
    is_sample,
    valid_time_reader,
)
from dyknow_stream_processing.ros.messages.sample_messages import sample_fields
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from dyknow_stream_processing.ros.topics.publications import (
    TopicNames,
    find_publication,
    is_kept,
    type_of_class,
)
from dyknow_stream_processing.ros.topics.topic_feed import MessageDoubt
from dyknow_stream_processing.sample import Sample, WholeMessage
from dyknow_stream_processing.violation import Violation, ViolationKind

WARNING_PERIOD_S: Final = 60.0
"""Minimum time between two warnings of one kind about a topic."""

RECENT_NS: Final = 10 * SECOND_NS
"""The time after a pause in which each loss of messages is taken for one of the pause."""

MAX_HELD: Final = 1000
"""The number of samples that may wait for the next step of simulated time."""


class TopicSources:
    """The sources of a dataflow: topics that push samples into it, and the node's clock.

    Simulated time advances in steps, and a sample may arrive before the step at which it was
    stamped. So a sample that is stamped ahead of simulated time is held until the next step.

    Args:
        quality_of_service: for every subscription; by default it is matched to the publishers.
        valid_times: the fields that hold the valid times, by topic; by default the stamps of the
            headers.
        message_types: the classes of topics that are known before they are published.
    """

    def __init__(
        self,
        node: Node,
        dataflow: Dataflow,
        quality_of_service: QoSProfile | None = None,
        valid_times: Mapping[str, str] | None = None,
        message_types: Mapping[str, Any] | None = None,
        clock_tolerance: int = CLOCK_TOLERANCE_NS,
    ) -> None:
        self._node = node
        self._dataflow = dataflow
        self._quality_of_service = quality_of_service
        self._valid_times = valid_times or {}
        self._message_types = message_types or {}
        self._clock_tolerance = clock_tolerance
        self._topics = NodeTopics.of(node)
        self._names = TopicNames(node)
        self._sources: dict[str, _Source] = {}
        self._held: deque[_Arrival] = deque()
        self._end_restarts = self._topics.restart_with(self._restart)

    def refresh(self) -> None:
        """Subscribe to the topics that the dataflow needs now, and to no others."""
        needed, owed = self._dataflow.sources(), self._dataflow.owed
        for topic in self._sources.keys() - needed.keys():
            self._sources.pop(topic).remove()
        for topic, fields in needed.items():
            known = self._sources.get(topic)
            if known is None:
                self._add(topic, fields)
            elif WHOLE in fields - known.fields and not (topic in owed and known.keeps_all):
                # Built-in sources need the messages that publishers keep: a new subscription.
                known.remove()
                self._add(topic, fields)
            else:
                known.set_fields(fields)
        self._topics.refresh()
        self._repeat_kept()
        self._schedule()

    def _repeat_kept(self) -> None:
        """Give new streams what a subscription of their own would receive from its publisher."""
        now = self._node.get_clock().now().nanoseconds
        for topic in self._dataflow.owed & self._sources.keys():
            if (kept := self._sources[topic].kept_sample(now)) is not None:
                self._dataflow.repeat(topic, kept)

    def catch_up(self) -> bool:
        """Do the work that is due now; return False if messages of before may not be there yet."""
        now = self._node.get_clock().now().nanoseconds
        if not self._topics.catch_up(now):
            return False
        self._advance(now)
        return True

    def processed_until(self) -> int:
        """Do the work that is due; return the time until which all messages are processed.

        It is earlier than now while messages wait, or may not be there yet after a pause of the
        process; in nanoseconds.
        """
        self.catch_up()
        now = self._node.get_clock().now().nanoseconds
        return int(max(now - max(self._topics.pause(now), self._topics.lag(now)), 0))

    def lag(self) -> int:
        """Return for how long the oldest message has waited, in nanoseconds."""
        return self._topics.lag(self._node.get_clock().now().nanoseconds)

    def expect(self, topic: str, stream_id: int) -> bool:
        """Expect the samples of a stream on a topic; see `NodeTopics.expect`."""
        for source in self._sources.values():
            if self._node.resolve_topic_name(source.topic) == topic:
                source.stream_id = stream_id
        return self._topics.expect(topic, stream_id)

    def report(self, topic: str) -> SourceReport:
        """Return the report of a topic that is subscribed to."""
        source = self._sources[topic]
        name = self._node.resolve_topic_name(topic)
        transport = source.clock.transport or 0
        return SourceReport(
            name,
            source.received,
            source.latest,
            source.delay,
            source.before_sending,
            transport,
            source.stream_id,
            source.rate,
            dict(source.drops + self._dataflow.dropped(topic)),
        )

    def end_period(self, now: int) -> None:
        """Measure the rates of all topics since the last call, given the time in nanoseconds."""
        for source in self._sources.values():
            source.end_period(now)

    def reason(self, topic: str, since: int | None) -> str:
        """Return why no messages of a topic that is subscribed to come; empty if they come.

        Args:
            topic: its name.
            since: the time after which they came lately, nanoseconds; None if that is unknown.
        """
        source = self._sources[topic]
        name = self._node.resolve_topic_name(topic)
        try:
            publication = find_publication(self._node, topic)
        except StreamError as error:
            return error.message
        # What was wrong with the messages of publishers has gone with them.
        fault = (publication and source.fault) or self._topics.fault(name)
        return topic_reason(
            name,
            is_published=publication is not None,
            has_received=source.received > 0,
            is_silent=since is not None
            and last_sign(name, source.latest or 0, source.promised) <= since,
            is_latched=publication is not None and publication.latched,
            fault=fault,
            nearest=() if publication else self._names.nearest(name),
        )

    def destroy(self) -> None:
        """Destroy all subscriptions; a second call does nothing."""
        self._end_restarts()
        self._held.clear()
        self._clear()

    def _add(self, topic: str, fields: Demand) -> None:
        source = _Source(
            self._node,
            topic,
            fields,
            self._valid_times.get(topic),
            self._dataflow,
            self._schedule,
            self._arrive,
            self._clock_tolerance,
        )
        source.remove = self._topics.listen(
            topic, source, self._quality_of_service, self._message_types.get(topic)
        )
        self._sources[topic] = source

    def _clear(self) -> None:
        self._topics.timed_calls.cancel(self._advance)
        for source in self._sources.values():
            source.remove()
        self._sources.clear()

    def _restart(self, set_back: int) -> None:
        """Discard all samples, as the clock was set back, or is another one if that is 0."""
        now = self._node.get_clock().now().nanoseconds
        while self._held:
            self._release_first(now)
        change = f'the clock was set back by {round_duration(set_back)}'
        text = f'{change if set_back else "use_sim_time was changed"}; all streams restart'
        self._clear()
        self._dataflow.restart(Violation('', ViolationKind.VALID_TIME_ORDER, now, now, 0, 0, text))
        self.refresh()

    def _arrive(self, arrival: _Arrival) -> None:
        """Process a sample after the held ones; hold it if simulated time is behind it."""
        now = arrival.time
        # Simulated time may have advanced, and the timer that releases them has not yet run.
        self._release(now)
        is_ahead = arrival.valid_time - now > self._dataflow.max_lead
        if is_ahead and self._topics.is_time_simulated and len(self._held) < MAX_HELD:
            self._held.append(arrival)
            self._schedule()
        else:
            arrival.source.push(arrival, now)

    def _schedule(self) -> None:
        deadline = self._dataflow.next_deadline()
        if deadline is not None:
            self._topics.timed_calls.schedule(self._advance, deadline)
        if self._held:
            self._topics.timed_calls.schedule(self._advance, self._held[0].time + 1)

    def _advance(self, now: int) -> None:
        self._release(now)
        self._dataflow.advance(now)
        self._schedule()

    def _release(self, now: int) -> None:
        """Process the samples that have been held since an earlier time than now."""
        while self._held and self._held[0].time < now:
            self._release_first(now)

    def _release_first(self, now: int) -> None:
        arrival = self._held.popleft()
        arrival.source.push(arrival, now)


class _Arrival(NamedTuple):
    """A message with its valid time and the time of its receipt, in nanoseconds."""

    source: _Source
    message: Any
    valid_time: int
    time: int
    is_initial: bool


@dataclass(eq=False, slots=True)
class _Source:
    """Listener that converts the messages of a topic to samples of a dataflow."""

    node: Node
    topic: str
    fields: Demand
    valid_time_field: str | None
    dataflow: Dataflow
    schedule: Callable[[], None]
    arrive: Callable[[_Arrival], None]
    clock_tolerance: int
    remove: Callable[[], None] = lambda: None
    """Ends its subscription."""
    clock: SenderClock = field(default_factory=SenderClock)
    before_sending: int = 0
    received: int = 0
    drops: Counter[str] = field(default_factory=Counter)
    rate: float = 0.0
    period: tuple[int, int] = (0, 0)
    """Its beginning, and the number of messages received before it."""
    latest: int | None = None
    latest_valid_time: int = 0
    promised: int = 0
    delay: int = 0
    is_sample: bool = False
    stream_id: int = 0
    """The stream whose samples come or are expected; 0 for other messages."""
    fault: str = ''
    """Why no message could be used so far."""
    zero_warning: Throttle = field(default_factory=lambda: Throttle(WARNING_PERIOD_S))
    class_: Any = None
    type_: SourceType | None = None
    read_valid_time: Callable[[Any], int] | None = None
    extract: Callable[[Any], Mapping[str, Value]] | None = None
    kept: _Arrival | None = None
    """The latest message, if all publishers keep what they publish."""

    def set_fields(self, fields: Demand) -> None:
        if fields != self.fields:
            self.fields = fields
            if self.extract is not None:
                self.extract = _extractor(self.class_, fields)

    def on_type(self, class_: Any) -> None:
        if class_ is self.class_:
            return
        self.class_, self.extract, self.type_, self.kept = class_, None, None, None
        self.is_sample = is_sample(class_)
        try:
            self.type_ = type_of_class(self.node, class_, self.valid_time_field, 0, is_kept=False)
        except StreamError as error:
            self.fault = f'messages of {self.topic} cannot be used: {error}'
            raise
        self.fault = ''
        self.read_valid_time = valid_time_reader(class_, self.valid_time_field)
        self.extract = _extractor(class_, self.fields)
        self.dataflow.set_source_type(self.topic, self.type_)

    def on_publishers(self, count: int, *, is_latched: bool) -> None:
        if self.type_ is not None:
            is_kept = is_latched and not self.is_sample
            self.type_ = replace(self.type_, has_ordered_stamps=count == 1, is_kept=is_kept)
            self.dataflow.set_source_type(self.topic, self.type_)

    def valid_time(self, message: Any) -> int | None:
        if self.read_valid_time is None or type(message) is not self.class_:
            return None
        return self.read_valid_time(message) or None

    def on_message(self, message: Any, now: int, sent_at: int, *, is_initial: bool) -> None:
        self.received += 1
        self.latest = now
        if self.extract is None:
            return  # The type cannot be used, which is logged.
        if type(message) is not self.class_:
            self._reject(now, now, 'the type of the topic has changed')
            return
        if self.is_sample and message.stream_id:
            self.stream_id = message.stream_id
        unstamped = sent_at or now
        valid_time = unstamped if self.read_valid_time is None else self.read_valid_time(message)
        if valid_time <= 0:
            if valid_time < 0:
                self._reject(valid_time, now, 'it is stamped with a time before 1970')
                return
            if self.zero_warning.is_due():
                self.node.get_logger().warning(
                    f"topic '{self.topic}' leaves its stamps at zero: the time at which the "
                    'message was sent is used'
                )
            valid_time = unstamped
        if sent_at and not is_initial:
            self._compare_clocks(valid_time, sent_at, now)
        self.arrive(_Arrival(self, message, valid_time, now, is_initial))

    def _compare_clocks(self, valid_time: int, sent_at: int, now: int) -> None:
        self.before_sending = sent_at - valid_time
        self.clock.note(sent_at, now)
        if fault := self.clock.fault(now, self.clock_tolerance):
            observed, allowed = abs(self.clock.transport or 0), self.clock_tolerance
            text = f"stream '{self.topic}': {fault}"
            kind = ViolationKind.CLOCK
            self.on_violation(Violation(self.topic, kind, valid_time, now, observed, allowed, text))

    def push(self, arrival: _Arrival, now: int) -> None:
        """Push a sample into the dataflow, with the fields that it needs now."""
        message, valid_time = arrival.message, arrival.valid_time
        self.latest_valid_time = valid_time
        if self.extract is None or type(message) is not self.class_:
            self._reject(valid_time, now, 'the type of the topic has changed')
            return
        self.delay = now - valid_time
        try:
            sample = Sample(valid_time, now, self.extract(message), self._watermark(message, now))
        except StreamError as error:
            self._reject(valid_time, now, str(error))
            return
        self.fault = ''
        self.kept = arrival if self.type_ is not None and self.type_.is_kept else None
        self.dataflow.push(
            self.topic,
            sample,
            is_checked=self._is_checked(message, now),
            is_initial=arrival.is_initial,
        )
        self.schedule()

    @property
    def keeps_all(self) -> bool:
        """True if a new subscription would receive the kept message alone, of one publisher."""
        return self.kept is not None and self.type_ is not None and self.type_.has_ordered_stamps

    def kept_sample(self, now: int) -> Sample | None:
        """Return the sample that a new subscription would receive now; None if there is none."""
        if self.kept is None or self.extract is None or not is_kept(self.node, self.topic):
            return None
        try:
            return Sample(self.kept.valid_time, now, self.extract(self.kept.message))
        except StreamError:
            return None  # It is reported with the next message.

    def on_watermark(self, watermark: int, now: int) -> None:
        self.promised = watermark
        self.dataflow.vouch(self.topic, min(watermark, now + self.dataflow.max_lead), now)
        self.schedule()

    def end_period(self, now: int) -> None:
        begin, received = self.period
        is_known = 0 < begin < now  # Simulated time may stand still.
        self.rate = (self.received - received) * SECOND_NS / (now - begin) if is_known else 0.0
        self.period = now, self.received

    def on_dropped(self, reason: str, count: int) -> None:
        self.drops[reason] += count
        self.dataflow.drop(self.topic, reason, count)

    def on_doubt(self, doubt: MessageDoubt, pause: Pause) -> None:
        if doubt is MessageDoubt.BEFORE:
            self.dataflow.doubt(self.topic, pause)
            self.schedule()
        elif doubt is MessageDoubt.NEXT:
            self.dataflow.lose(self.topic, self._loss(pause))
        elif doubt is MessageDoubt.PERHAPS:
            self.dataflow.lose(self.topic)
        else:
            self.dataflow.trust(self.topic)

    def _loss(self, pause: Pause) -> Violation | None:
        """Return the violation of all streams whose messages were lost in a recent pause."""
        now = self.node.get_clock().now().nanoseconds
        since = self.latest_valid_time
        if min(since, now - RECENT_NS) > pause.settled:
            return None
        text = (
            f"stream '{self.topic}': messages after the one valid at {round_time(since)} were "
            f'lost, as the node that reads them did not run for '
            f'{round_duration(pause.ended - pause.began)} until {round_time(pause.ended)}'
        )
        return Violation(self.topic, ViolationKind.LOST, since + 1, now, 0, 0, text)

    def on_violation(self, violation: Violation) -> None:
        self.dataflow.report(self.topic, violation)

    def _watermark(self, message: Any, now: int) -> int | None:
        """Return the watermark that an engine gave a sample, unless its clock is ahead."""
        if not (self.is_sample and message.watermark):
            return None
        watermark = time_to_nanoseconds(message.watermark[0])
        is_checked = self._is_checked(message, now)
        return watermark if is_checked else min(watermark, now + self.dataflow.max_lead)

    def _is_checked(self, message: Any, now: int) -> bool:
        """Return True if an engine has made a sample, by a clock that is not ahead of this one."""
        if not (self.is_sample and message.watermark):
            return False
        available_time = time_to_nanoseconds(message.available_time)
        return 0 < available_time <= now + self.dataflow.max_lead

    def _reject(self, valid_time: int, now: int, fault: str) -> None:
        text = f"stream '{self.topic}': a message cannot be used: {fault}"
        self.fault = self.fault or f'messages of {self.topic} cannot be used: {fault}'
        self.kept = None
        self.on_dropped(ViolationKind.MESSAGE, 1)
        self.on_violation(Violation(self.topic, ViolationKind.MESSAGE, valid_time, now, 0, 0, text))


def _extractor(class_: Any, fields: Demand) -> Callable[[Any], Mapping[str, Value]]:
    # If the messages lack a field, the operator that needs it reports that at each sample.
    extract = sample_fields if is_sample(class_) else extractor(class_, fields - {WHOLE})
    if WHOLE not in fields:
        return extract
    return lambda message: WholeMessage(extract(message), message)
