"""The stream processing engine: makes streams from specifications (paper, VI-A.1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dyknow_interfaces.msg import ConstraintViolation, Sample
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dyknow_common import StreamConstraints
from dyknow_common.ros import (
    NO_PUBLISHER_EVENTS,
    RUNNING,
    STREAM,
    VIOLATIONS,
    DyKnowNode,
    Throttle,
    constraints_from_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    run,
)
from dyknow_stream_processing.dataflow.computational_units import load_units
from dyknow_stream_processing.dataflow.dataflow import Dataflow
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.management.naming import check_name
from dyknow_stream_processing.reporting.stream_report import (
    STILL,
    Flow,
    FlowMeter,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.ros.messages.sample_messages import SampleWriter
from dyknow_stream_processing.ros.messages.stream_report_messages import StreamReportPublisher
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources, source_type
from dyknow_stream_processing.sample import Sample as DataSample
from dyknow_stream_processing.violation import Violation

WARNING_PERIOD = 1.0
"""Seconds between two violations in the log; each is published."""


@dataclass(slots=True)
class _Output:
    """What a stream is published on, and how it flows."""

    topic: str
    constraints: StreamConstraints
    samples: Any
    violations: Any
    meter: FlowMeter
    is_wanted: bool = False
    writer: SampleWriter = field(default_factory=SampleWriter)
    flow: Flow = STILL


class StreamProcessingEngine(DyKnowNode):
    """Publishes the streams that it is asked to make."""

    def __init__(self) -> None:
        super().__init__('stream_processing_engine')
        self._prefix = self.parameter(
            'stream_prefix', 'dyknow/streams', 'Topics of streams are named <stream_prefix>/<name>.'
        )
        self._check_prefix()
        self._dataflow = Dataflow(load_units(), lambda topic: source_type(self, topic))
        self._sources = TopicSources(self, self._dataflow)
        self._outputs: dict[str, _Output] = {}
        self._streams_report = StreamReportPublisher(
            self, lambda: [self.get_fully_qualified_name()], self._accounts, self._end_period
        )
        self._warning = Throttle(WARNING_PERIOD)
        self.serve(StreamCreateFromSpec, self._create)
        self.serve(StreamDestroy, self._destroy)
        self.serve(ListStreams, self._list)
        # Who has no streams says so: only then is it given some.
        self._streams_report.changed()

    def _check_prefix(self) -> None:
        try:
            validate_topic_name(f'{self._prefix}/name')
        except InvalidTopicNameException as error:
            raise StreamError(f"stream_prefix '{self._prefix}' cannot be used: {error}") from None

    def _create(self, request: Any, response: Any) -> None:
        spec = request.spec
        check_name(spec.name)
        specification = parse_specification(spec.specification)
        constraints = constraints_from_message(spec.constraints)
        self._dataflow.create(
            spec.name,
            specification,
            constraints,
            lambda sample: self._publish_sample(spec.name, sample),
            lambda violation: self._publish_violation(spec.name, violation),
        )
        output = self._make_output(spec.name, constraints)
        self._outputs[spec.name] = output
        self._sources.refresh()
        self._streams_report.changed()
        response.stream_topic = output.topic
        response.stream_constraint_violation_topic = f'{output.topic}/violations'

    def _make_output(self, name: str, constraints: StreamConstraints) -> _Output:
        topic = self.resolve_topic_name(f'{self._prefix}/{name}')
        return _Output(
            topic=topic,
            constraints=constraints,
            samples=self.create_publisher(
                Sample, topic, STREAM, event_callbacks=NO_PUBLISHER_EVENTS
            ),
            violations=self.create_publisher(
                ConstraintViolation,
                f'{topic}/violations',
                VIOLATIONS,
                event_callbacks=NO_PUBLISHER_EVENTS,
            ),
            meter=FlowMeter(self.now()),
        )

    def _destroy(self, request: Any, _response: Any) -> None:
        self._dataflow.destroy(request.stream_name)
        output = self._outputs.pop(request.stream_name)
        self.destroy_publisher(output.samples)
        self.destroy_publisher(output.violations)
        self._sources.refresh()
        self._streams_report.changed()

    def _list(self, _request: Any, response: Any) -> None:
        response.stream_names = sorted(self._dataflow.names())

    def _end_period(self) -> None:
        now = self.now()
        for output in self._outputs.values():
            output.flow = output.meter.measure(now)
        samples = sum(self._dataflow.statistics(name).samples for name in self._outputs)
        self.set_status(RUNNING, {'streams': str(len(self._outputs)), 'samples': str(samples)})

    def _accounts(self) -> list[StreamReport]:
        return [self._account(name, output) for name, output in self._outputs.items()]

    def _account(self, name: str, output: _Output) -> StreamReport:
        statistics = self._dataflow.statistics(name)
        return StreamReport(
            name=name,
            state=StreamState.FLOWING,
            engine=self.get_fully_qualified_name(),
            topic=output.topic,
            specification=self._dataflow.specification(name),
            constraints=output.constraints,
            samples=statistics.samples,
            violations=statistics.violations,
            drops=statistics.drops,
            sources=tuple(map(self._sources.account, self._dataflow.topics(name))),
            flow=output.flow,
        )

    def _publish_sample(self, name: str, sample: DataSample) -> None:
        output = self._outputs[name]
        output.meter.note(sample)
        # Many streams are there for others of this engine alone, and messages are what costs most.
        # Who has listened once learns by the numbers of messages what it missed while it was away.
        output.is_wanted = output.is_wanted or output.samples.get_subscription_count() > 0
        if output.is_wanted:
            output.samples.publish(output.writer.write(sample))

    def _publish_violation(self, name: str, violation: Violation) -> None:
        message = ConstraintViolation(
            stream_name=violation.stream_name,
            constraint=str(violation.constraint),
            valid_time=nanoseconds_to_time(violation.valid_time),
            available_time=nanoseconds_to_time(violation.available_time),
            observed=nanoseconds_to_duration(violation.observed),
            allowed=nanoseconds_to_duration(violation.allowed),
            message=violation.message,
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._outputs[name].violations.publish(message)
        if self._warning.is_due():
            self.get_logger().warning(f'{name}: {violation.message}')


def main() -> int:
    """The executable stream_processing_engine."""
    return run(StreamProcessingEngine)
