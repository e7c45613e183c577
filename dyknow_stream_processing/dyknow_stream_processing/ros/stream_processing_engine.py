"""The stream processing engine: makes streams from specifications (paper, VI-A.1)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import ConstraintViolation, Sample, StreamWatermark
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS, StreamConstraints, with_readable_times
from dyknow_common.ros import (
    RUNNING,
    STREAM,
    VIOLATIONS,
    Background,
    DirectPublisher,
    DyKnowNode,
    Throttle,
    absolute_topic,
    constraints_from_message,
    identities_from_message,
    nanoseconds_to_time,
    run,
    to_message,
    topic_fault,
)
from dyknow_stream_processing.dataflow.computational_units import load_units
from dyknow_stream_processing.dataflow.dataflow import DEFAULT_MAX_LEAD, Dataflow
from dyknow_stream_processing.dataflow.operators import DEFAULT_DELAYS, DelayLimits
from dyknow_stream_processing.errors import StreamError, stream_replaced
from dyknow_stream_processing.language.sinks import sink_message
from dyknow_stream_processing.language.specification import (
    LANGUAGE,
    Specification,
)
from dyknow_stream_processing.language.term_sizes import check_rates
from dyknow_stream_processing.language.type_rules import Unit
from dyknow_stream_processing.management.naming import check_name
from dyknow_stream_processing.reporting.sender_clock import CLOCK_TOLERANCE_NS
from dyknow_stream_processing.reporting.stream_report import (
    NO_FLOW,
    Flow,
    FlowMeter,
    StreamReport,
    StreamState,
    is_hidden,
)
from dyknow_stream_processing.ros.messages.sample_messages import SampleWriter
from dyknow_stream_processing.ros.messages.stream_report_messages import StreamReportPublisher
from dyknow_stream_processing.ros.stream_limits import StreamLimits, parse_beside
from dyknow_stream_processing.ros.topics.publications import publishers_remark, source_type
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources
from dyknow_stream_processing.ros.topics.violation_relay import VIOLATIONS_SUFFIX, violations_topic
from dyknow_stream_processing.ros.topics.waiting_streams import WaitingStreams
from dyknow_stream_processing.ros.topics.watermark_topics import WatermarkPublisher
from dyknow_stream_processing.ros.typed_output import TypedOutput
from dyknow_stream_processing.sample import Sample as DataSample
from dyknow_stream_processing.violation import Violation, ViolationKind

WARNING_PERIOD_S: Final = 1.0
"""Minimum time between two violations in the log; all are published."""


UNPUBLISHED: Final = 'unpublished'
"""The reason under which samples are counted that do not fit into the messages of their sink."""

MAX_STREAMS: Final = 2000
"""The default number of streams that an engine makes at once."""


@dataclass(slots=True)
class _Output:
    """The publishers and the flow of a stream."""

    topic: str
    constraints: StreamConstraints
    writer: SampleWriter
    samples: DirectPublisher
    violations: DirectPublisher
    meter: FlowMeter
    typed: TypedOutput | None = None
    waits_for: str = ''
    """The reason in the last report."""
    watermark: int = 0
    """The watermark of the last sample."""
    flow: Flow = NO_FLOW


class StreamProcessingEngine(DyKnowNode):
    """Node that makes and publishes streams on request."""

    def __init__(self) -> None:
        super().__init__('stream_processing_engine')
        self._prefix = self.parameter(
            'stream_prefix', 'dyknow/streams', 'Topics of streams are named <stream_prefix>/<name>.'
        )
        if fault := topic_fault(self, f'{self._prefix}/name', VIOLATIONS_SUFFIX):
            raise StreamError(f"stream_prefix '{self._prefix}' cannot be used: {fault}")
        self._limits = StreamLimits(self, MAX_STREAMS)
        units = load_units()
        self.set_loaded({'computational units': len(units)})
        self.set_status(RUNNING)
        self._dataflow = self._new_dataflow(units)
        tolerance = self._limit(
            'clock_tolerance',
            CLOCK_TOLERANCE_NS,
            'Seconds by which the clock of the sender of a topic may differ from the one here.',
        )
        self._sources = TopicSources(self, self._dataflow, clock_tolerance=tolerance)
        self._waiting = WaitingStreams(self, self._dataflow, self._sources)
        self._outputs: dict[str, _Output] = {}
        self._background = Background(self)
        name, processed_until = self.get_fully_qualified_name(), self._sources.processed_until
        self._report_publisher = StreamReportPublisher(
            self, lambda: [name], self._reports, processed_until, self._end_period
        )
        self._warning = Throttle(WARNING_PERIOD_S)
        self._notice = Throttle(WARNING_PERIOD_S)
        WatermarkPublisher(self, self._prefix, self._watermarks)
        self.serve(StreamCreateFromSpec, self._create)
        self.serve(StreamDestroy, self._destroy)
        self.serve(ListStreams, self._list)
        # Report an empty list too: only engines that have reported are given streams.
        self._report_publisher.publish_soon()

    def _new_dataflow(self, units: Mapping[str, Unit]) -> Dataflow:
        max_lead = self._limit(
            'default_max_lead',
            DEFAULT_MAX_LEAD,
            'Seconds by which stamps may be ahead of the clock where a stream gives no max_lead.',
        )
        delays = DelayLimits(
            self._limit(
                'default_max_delay',
                DEFAULT_DELAYS.stamped,
                'Seconds by which messages may come later than their stamps where a stream gives '
                'no max_delay.',
            ),
            self._limit(
                'default_transport_delay',
                DEFAULT_DELAYS.sent,
                'Seconds by which messages without stamps may come later than they were sent where '
                'a stream gives no max_delay.',
            ),
        )
        return Dataflow(
            units,
            lambda topic: source_type(self, topic),
            max_lead,
            lambda topics: publishers_remark(self, topics),
            delays,
        )

    def _limit(self, name: str, default_ns: int, description: str) -> int:
        seconds: float = self.parameter(name, default_ns / SECOND_NS, description, (0.0, 3600.0))
        return round(seconds * SECOND_NS)

    async def _create(self, request: Any, response: Any) -> None:
        spec = request.spec
        check_name(spec.name)
        specifications = list(map(self._dataflow.specification, self._outputs))
        self._limits.check(specifications, spec, self._sources.lag())
        topic = f'{self._prefix}/{spec.name}'
        topic = absolute_topic(self, topic, 'the topic of the stream', VIOLATIONS_SUFFIX)
        specification = await parse_beside(self._background, spec.specification)
        constraints = constraints_from_message(spec.constraints)
        check_rates(specification, constraints)
        sources = identities_from_message(request.sources)
        self._expect(sources)
        self._dataflow.create(
            spec.name,
            specification,
            constraints,
            lambda sample: self._publish_sample(spec.name, sample),
            lambda violation: self._publish_violation(spec.name, violation),
        )
        if request.is_recreated:
            self._dataflow.complete_windows(spec.name)
        try:
            output = self._output(spec.name, specification, constraints, topic)
        except Exception:
            self._dataflow.destroy(spec.name)
            raise
        self._outputs[spec.name] = output
        self._sources.refresh()
        # Topics that nobody has read here before.
        self._expect(sources)
        self._waiting.add(spec.name)
        self._report_publisher.publish_soon()
        response.stream_topic = topic
        response.stream_constraint_violation_topic = violations_topic(topic)
        response.stream_id = output.writer.stream_id

    def _expect(self, sources: Mapping[str, int]) -> None:
        """Let topics have the streams that a client has chosen.

        Raises:
            StreamError: UNAVAILABLE, naming a topic that has another stream.
        """
        own = {output.topic: output.writer.stream_id for output in self._outputs.values()}
        for topic, stream_id in sources.items():
            if topic in own and own[topic] != stream_id:
                raise stream_replaced(topic)
            if topic not in own and not self._sources.expect(topic, stream_id):
                raise stream_replaced(topic)

    def _output(
        self, name: str, specification: Specification, constraints: StreamConstraints, topic: str
    ) -> _Output:
        """Return the output of a new stream."""
        writer, published, typed = SampleWriter(), sink_message(specification), None
        if published is not None:  # First: it fails most often.
            fields, sources = self._dataflow.fields(name), self._dataflow.topics(name)
            with LANGUAGE.errors_at(specification.text, published.position):
                typed = TypedOutput(self, published, fields, topic, sources)
        return _Output(
            topic=topic,
            constraints=constraints,
            writer=writer,
            samples=DirectPublisher(self, Sample, topic, STREAM, writer.write),
            violations=DirectPublisher(
                self, ConstraintViolation, violations_topic(topic), VIOLATIONS
            ),
            meter=FlowMeter(self.now()),
            typed=typed,
        )

    def _destroy(self, request: Any, _response: Any) -> None:
        self._dataflow.destroy(request.stream_name)
        self._waiting.remove(request.stream_name)
        output = self._outputs.pop(request.stream_name)
        output.samples.destroy()
        output.violations.destroy()
        if output.typed is not None:
            output.typed.destroy()
        self._sources.refresh()
        self._report_publisher.publish_soon()

    def _list(self, _request: Any, response: Any) -> None:
        response.stream_names = sorted(self._dataflow.names())

    def _end_period(self) -> None:
        now = self.now()
        for output in self._outputs.values():
            output.flow = output.meter.measure(now)
        self._sources.end_period(now)
        self._waiting.end_period()
        samples = sum(self._dataflow.statistics(name).samples for name in self._outputs)
        values = {'streams': str(len(self._outputs)), 'samples': str(samples)}
        if faults := self._dataflow.warnings():
            values['faults'] = '\n'.join(faults)
        self.set_status(RUNNING, values, level=DiagnosticStatus.WARN if faults else None)

    def _reports(self) -> Iterator[StreamReport]:
        for name, output in self._outputs.items():
            statistics = self._dataflow.statistics(name)
            output.waits_for = self._waiting.reason(name)
            yield StreamReport(
                name=name,
                state=StreamState.WAITING if output.waits_for else StreamState.FLOWING,
                message=output.waits_for,
                engine=self.get_fully_qualified_name(),
                topic=output.topic,
                stream_id=output.writer.stream_id,
                specification=self._dataflow.specification(name),
                constraints=output.constraints,
                samples=statistics.samples,
                violations=statistics.violations,
                drops=statistics.drops,
                sources=tuple(map(self._sources.report, self._dataflow.topics(name))),
                flow=output.flow,
            )

    def _publish_sample(self, name: str, sample: DataSample) -> None:
        output = self._outputs[name]
        output.meter.note(sample)
        if output.waits_for:
            output.waits_for = ''
            self._report_publisher.publish_soon()
        # Publishing is what costs most, and only other streams of this engine use many streams.
        # A stream that once had a subscriber stays published: a subscriber that was out of reach
        # counts the samples that it missed by their sequence numbers.
        if output.samples.is_for_others:
            output.watermark = max(sample.watermark or 0, 0)
        output.samples.publish(sample)
        if output.typed is not None:
            self._publish_typed(name, output.typed, sample)

    def _publish_typed(self, name: str, typed: TypedOutput, sample: DataSample) -> None:
        try:
            typed.publish(sample)
        except StreamError as error:
            self._dataflow.count_drop(name, UNPUBLISHED)
            if self._warning.is_due():
                self.get_logger().warning(
                    f'{name}: a sample cannot be published on {typed.topic}: {error}'
                )

    def _watermarks(self) -> Iterator[Any]:
        """Yield the watermarks that differ from the last samples': later, or after a restart."""
        if not self._sources.catch_up():
            return
        for name, output in self._outputs.items():
            watermark = self._dataflow.watermark(name)
            if watermark != output.watermark and output.samples.is_for_others:
                yield StreamWatermark(
                    stream_name=name,
                    stream_id=output.writer.stream_id,
                    number=output.writer.number,
                    watermark=nanoseconds_to_time(watermark),
                )

    def _publish_violation(self, name: str, violation: Violation) -> None:
        topics = map(self.resolve_topic_name, self._dataflow.topics(name))
        if violation.constraint == ViolationKind.SOURCE and violation.stream_name in topics:
            # Made from another stream, it gets a new id, which its users must receive.
            self._outputs[name].writer.renew()
            self._report_publisher.publish_soon()
        # The node may be later than the receipt of the sample. Subscribers ignore violations from
        # before their subscription, but the sample may matter for a stream that was created since.
        detected = max(violation.available_time, self.now())
        message = to_message(replace(violation, available_time=detected), ConstraintViolation())
        message.header.stamp = message.available_time
        self._outputs[name].violations.publish(message)
        self._outputs[name].writer.note_violation(detected)
        text = f'{name}: {with_readable_times(violation.message)}'
        if not is_hidden(name):
            if self._warning.is_due():
                self.get_logger().warning(text)
        # The maker of the stream, such as the coordinator, warns with the names of its users.
        elif self._notice.is_due():
            self.get_logger().info(text)


def main() -> int:
    """Run the executable stream_processing_engine."""
    return run(StreamProcessingEngine)
