"""The stream processing engine: makes streams from specifications (paper, VI-A.1)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dyknow_interfaces.msg import ConstraintViolation, Sample
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_stream_processing.computational_units import load_units
from dyknow_stream_processing.dataflow import Dataflow
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.parsing import parse_specification
from dyknow_stream_processing.ros.conversion import (
    constraints_from_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
)
from dyknow_stream_processing.ros.runtime import (
    NO_PUBLISHER_EVENTS,
    RUNNING,
    STREAM,
    VIOLATIONS,
    DyKnowNode,
    run,
)
from dyknow_stream_processing.ros.sample_messages import SampleWriter
from dyknow_stream_processing.ros.topic_sources import TopicSources, source_type

if TYPE_CHECKING:
    from dyknow_stream_processing.dataflow import Statistics
    from dyknow_stream_processing.violation import Violation

REPORT_PERIOD = 1.0
"""Seconds between two accounts of the streams on the status topic."""

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


@dataclass(frozen=True, slots=True)
class _Output:
    samples: Any
    violations: Any


class StreamProcessingEngine(DyKnowNode):
    """Publishes the streams that it is asked to make."""

    def __init__(self) -> None:
        super().__init__('stream_processing_engine')
        self._prefix = self.parameter(
            'stream_prefix', 'dyknow/streams', 'Topics of streams are named <stream_prefix>/<name>.'
        )
        self._dataflow = Dataflow(load_units(), lambda topic: source_type(self, topic))
        self._sources = TopicSources(self, self._dataflow)
        self._outputs: dict[str, _Output] = {}
        self.serve(StreamCreateFromSpec, self._create)
        self.serve(StreamDestroy, self._destroy)
        self.serve(ListStreams, self._list)
        self.create_timer(REPORT_PERIOD, self._report, clock=self.wall_clock)

    def _create(self, request: Any, response: Any) -> None:
        spec = request.spec
        if not _NAME.fullmatch(spec.name):
            raise StreamError(
                f"'{spec.name}' cannot be the name of a stream; use letters, digits and _, "
                f'beginning with a letter'
            )
        specification = parse_specification(spec.specification)
        constraints = constraints_from_message(spec.constraints)
        writer = SampleWriter()
        self._dataflow.create(
            spec.name,
            specification,
            constraints,
            lambda sample: self._outputs[spec.name].samples.publish(writer.write(sample)),
            lambda violation: self._publish_violation(spec.name, violation),
        )
        topic = f'{self._prefix}/{spec.name}'
        self._outputs[spec.name] = _Output(
            samples=self.create_publisher(
                Sample, topic, STREAM, event_callbacks=NO_PUBLISHER_EVENTS
            ),
            violations=self.create_publisher(
                ConstraintViolation,
                f'{topic}/violations',
                VIOLATIONS,
                event_callbacks=NO_PUBLISHER_EVENTS,
            ),
        )
        self._sources.refresh()
        response.stream_topic = self.resolve_topic_name(topic)
        response.stream_constraint_violation_topic = f'{response.stream_topic}/violations'

    def _destroy(self, request: Any, _response: Any) -> None:
        self._dataflow.destroy(request.stream_name)
        output = self._outputs.pop(request.stream_name)
        self.destroy_publisher(output.samples)
        self.destroy_publisher(output.violations)
        self._sources.refresh()

    def _list(self, _request: Any, response: Any) -> None:
        response.stream_names = sorted(self._dataflow.names())

    def _report(self) -> None:
        self.set_status(
            RUNNING, {name: _account(self._dataflow.statistics(name)) for name in self._outputs}
        )

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
        self.get_logger().warning(f'{name}: {violation.message}', throttle_duration_sec=1.0)


def _account(statistics: Statistics) -> str:
    """What has come of a stream, on one line."""
    drops = ', '.join(f'{count} {reason}' for reason, count in statistics.drops.items())
    return (
        f'{statistics.samples} samples, {statistics.violations} violations, '
        f'dropped: {drops or "none"}'
    )


def main() -> int:
    """The executable stream_processing_engine."""
    return run(StreamProcessingEngine)
