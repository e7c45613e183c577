"""The stream manager: knows every stream, and has engines make them (paper, VI-A.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import (
    ListStreams,
    StreamCreateFromSpec,
    StreamDestroy,
    StreamGetTopic,
    StreamRegister,
)

from dyknow_common.ros import (
    RUNNING,
    Background,
    DyKnowNode,
    Throttle,
    absolute_topic,
    constraints_from_message,
    identities_from_message,
    run,
)
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.management.naming import Namespaces, NamingConvention, check_name
from dyknow_stream_processing.management.persistence import PersistenceFile
from dyknow_stream_processing.management.registry import DEFAULT_CONVENTION, StreamRegistry
from dyknow_stream_processing.management.streams import (
    CreatedStream,
    RegisteredStream,
    Stream,
    read_streams,
)
from dyknow_stream_processing.reporting.silence import with_origins
from dyknow_stream_processing.reporting.stream_report import StreamReport, StreamState
from dyknow_stream_processing.ros.management.engines import Engines
from dyknow_stream_processing.ros.management.placement import Placement
from dyknow_stream_processing.ros.messages.message_types import message_class
from dyknow_stream_processing.ros.messages.stream_report_messages import StreamReportPublisher
from dyknow_stream_processing.ros.stream_limits import StreamLimits, parse_beside
from dyknow_stream_processing.ros.topics.publications import find_publication, is_kept
from dyknow_stream_processing.ros.topics.violation_relay import VIOLATIONS_SUFFIX

ERROR_PERIOD_S = 10.0
"""The least time between two log messages about a memory file that cannot be written."""


MAX_STREAMS = 5000
"""The default number of streams that were created or registered."""


class StreamManager(DyKnowNode):
    """Node that keeps the registry of streams and places new ones on engines."""

    _is_ready = False

    def __init__(self) -> None:
        super().__init__('stream_manager')
        memory = self.parameter(
            'memory', '', 'File that keeps all streams over a restart of the manager; empty: none.'
        )
        discovery_period_s = self.parameter(
            'discovery_period', 0.25, 'Seconds between two searches for new engines.', (0.01, 60.0)
        )
        self._limits = StreamLimits(self, MAX_STREAMS)
        self._registry = self._new_registry()
        self._memory = PersistenceFile(memory, self.get_fully_qualified_name())
        self._memory_error = Throttle(ERROR_PERIOD_S)
        for remembered in self._memory.read():
            if self._registry.get(remembered.name) is None:
                self._registry.add(remembered)
        self._memory.write(self._registry.streams())
        self._states: dict[str, dict[str, StreamState]] = {}
        self._engines = Engines(
            self,
            self._registry.engine_namespaces,
            discovery_period_s,
            self._on_engine_report,
            self._on_engine_lost,
        )
        parse = partial(parse_beside, Background(self))
        self._placement = Placement(
            self, self._registry, self._engines, parse, partial(is_kept, self), self._on_change
        )
        self._report_publisher = StreamReportPublisher(
            self, self._engines.ready, self._reports, self._engines.known_until
        )
        self.serve(StreamCreateFromSpec, self._create)
        self.serve(StreamDestroy, self._destroy)
        self.serve(ListStreams, self._list)
        self.serve(StreamRegister, self._register)
        self.serve(StreamGetTopic, self._get_topic)
        self._on_change()

    def _new_registry(self) -> StreamRegistry:
        """Return a registry with the streams of the files, as the parameters say."""
        files = self.parameter(
            'streams', [''], 'Files in the stream language; each sink in them is made at the start.'
        )
        convention = self.parameter(
            'naming_convention',
            DEFAULT_CONVENTION.pattern,
            'The topic of a stream that was neither created nor registered; <name> is its name.',
        )
        namespaces = self.parameter(
            'engine_namespaces',
            [''],
            'Namespaces whose engines are used, with all below them; default: that of the manager.',
        )
        own = self.get_namespace()
        registry = StreamRegistry(
            NamingConvention(convention), own, self._published, Namespaces.of(namespaces, own)
        )
        paths = list(filter(None, files))
        for stream in read_streams(map(Path, paths)):
            registry.add(stream)
        self.set_loaded({'streams': len(registry.streams()), 'files': len(paths)})
        return registry

    async def _create(self, request: Any, response: Any) -> None:
        spec = request.spec
        check_name(spec.name)
        self._limits.check(self._registry.specifications(), spec)
        constraints = constraints_from_message(spec.constraints)
        created = await self._placement.create(
            CreatedStream(spec.name, spec.specification, constraints),
            identities_from_message(request.sources),
        )
        response.stream_topic = created.stream_topic
        response.stream_constraint_violation_topic = created.stream_constraint_violation_topic
        response.stream_id = created.stream_id

    async def _destroy(self, request: Any, _response: Any) -> None:
        await self._placement.destroy(request.stream_name)

    def _list(self, _request: Any, response: Any) -> None:
        topics = [name for name, _ in self.get_topic_names_and_types()]
        response.stream_names = list(self._registry.listed_names(topics))

    def _register(self, request: Any, _response: Any) -> None:
        for name in ('stream_name', 'topic_name', 'message_type'):
            if not getattr(request, name):
                raise StreamError(f'{name} is empty; a stream needs a name, a topic and its type')
        check_name(request.stream_name)
        self._limits.check(self._registry.specifications())
        message_class(request.message_type)
        topic = absolute_topic(self, request.topic_name, 'topic_name', VIOLATIONS_SUFFIX)
        self._registry.add(RegisteredStream(request.stream_name, topic, request.message_type))
        self._placement.reconcile_soon()
        self._on_change()

    def _get_topic(self, request: Any, response: Any) -> None:
        response.topic_name = self._registry.topic(request.stream_name)
        response.message_type = self._registry.find(request.stream_name).message_type

    def _published(self, topic: str) -> tuple[str, str] | None:
        """Return the absolute name and the type of a topic that is published."""
        try:
            publication = find_publication(self, topic)
        except StreamError:
            return None  # It has several types, or the name is invalid.
        if publication is None:
            return None
        return self.resolve_topic_name(topic), publication.type_name

    def _on_engine_report(self, name: str) -> None:
        states = {each.name: each.state for each in self._engines.reports(name).values()}
        if states != self._states.get(name):
            self._states[name] = states
            self._report_publisher.publish_soon()
            self._update_status()
        is_settled = self._placement.is_settled(name)
        if not is_settled or self._registry.waiting() or self._placement.conflicts:
            self._placement.reconcile_soon()

    def _on_engine_lost(self, name: str) -> None:
        self.get_logger().warning(f'stream processing engine {name} is gone')
        self._placement.lose_engine(name)
        self._placement.reconcile_soon()
        self._on_change()

    def _reports(self) -> Iterator[StreamReport]:
        identities = self._placement.identities()
        return with_origins([self._report(each, identities) for each in self._registry.streams()])

    def _report(self, stream: Stream, identities: Mapping[str, int]) -> StreamReport:
        engine = getattr(stream, 'engine', None)
        reported = self._engines.reports(engine).get(stream.name) if engine else None
        report = self._registry.report(stream, reported)
        if isinstance(stream, RegisteredStream):
            return replace(report, message=self._registration_fault(stream))
        return replace(report, stream_id=identities.get(stream.topic, 0))

    def _registration_fault(self, stream: RegisteredStream) -> str:
        """Return why a topic is not published as it was registered; empty if it is."""
        try:
            found = find_publication(self, stream.topic)
        except StreamError as error:
            return str(error)
        if found is None:
            return f'nobody publishes {stream.topic}'
        if found.type_name == stream.message_type:
            return ''
        return (
            f'{stream.topic} has the type {found.type_name}, but is registered with '
            f'{stream.message_type}'
        )

    def _on_change(self) -> None:
        try:
            self._memory.write(self._registry.streams())
        except StreamError as error:
            if self._memory_error.is_due():
                self.get_logger().error(str(error))
        self._report_publisher.publish_soon()
        self._update_status()

    def log_ready(self) -> None:
        """Log once that there is an engine, and each stream is made or refused."""
        is_placed = all(stream.failed for stream in self._registry.waiting())
        if not self._is_ready and is_placed and self._engines.ready():
            self._is_ready = True
            super().log_ready()

    def _update_status(self) -> None:
        self.log_ready()
        unplaced = self._registry.waiting()
        waiting = [stream.name for stream in unplaced if not stream.failed]
        failed = [stream.name for stream in unplaced if stream.failed]
        level, message = DiagnosticStatus.OK, RUNNING
        if waiting:
            level, message = DiagnosticStatus.WARN, f'{len(waiting)} streams wait for an engine'
        if failed:
            level = DiagnosticStatus.ERROR
            message = f'streams that cannot be made: {", ".join(failed)}'
        if self._placement.conflicts:
            level = DiagnosticStatus.ERROR
            message = '; '.join(self._placement.conflicts.values())
        self.set_status(
            message,
            level=level,
            values={
                'streams': str(len(self._registry.names())),
                'waiting': ' '.join(waiting),
                'refused': str(len(failed)),
                'engines': ' '.join(self._engines.ready()),
                **{stream.name: stream.message for stream in unplaced if stream.message},
                **self._registry.recreated(),
            },
        )


def main() -> int:
    """Run the executable stream_manager."""
    return run(StreamManager)
