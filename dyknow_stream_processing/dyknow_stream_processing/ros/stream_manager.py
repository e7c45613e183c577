"""The stream manager: knows every stream, and has engines make them (paper, VI-A.2)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import (
    ListStreams,
    StreamCreateFromSpec,
    StreamDestroy,
    StreamGetTopic,
    StreamRegister,
)
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dyknow_stream_processing.constraints import NO_CONSTRAINTS
from dyknow_stream_processing.errors import DyKnowError, ExitCode, StreamError
from dyknow_stream_processing.parsing import parse_specification
from dyknow_stream_processing.registry import (
    CreatedStream,
    RegisteredStream,
    StreamRegistry,
    engines_missing,
)
from dyknow_stream_processing.ros.conversion import (
    constraints_from_message,
    constraints_to_message,
)
from dyknow_stream_processing.ros.message_types import message_class
from dyknow_stream_processing.ros.peer import Peer
from dyknow_stream_processing.ros.runtime import RUNNING, DyKnowNode, run
from dyknow_stream_processing.sinks import specifications_by_sink

if TYPE_CHECKING:
    from collections.abc import Iterable

_PASSING = (ExitCode.UNAVAILABLE, ExitCode.TIMEOUT)
"""What may go well when it is tried again."""

_ENGINE_SERVICE = '/stream_create_from_spec'
_ENGINE_SERVICE_TYPE = 'dyknow_interfaces/srv/StreamCreateFromSpec'


class StreamManager(DyKnowNode):
    """Serves what is known of streams, and places each new one on an engine."""

    def __init__(self) -> None:
        super().__init__('stream_manager')
        files = self.parameter(
            'streams', [''], 'Files in the stream language; each sink in them is made at the start.'
        )
        period = self.parameter(
            'discovery_period', 0.25, 'Seconds between two looks for new engines.', (0.01, 60.0)
        )
        self._registry = StreamRegistry()
        self._engines: dict[str, Peer] = {}
        self._settling = False
        self._unsettled = False
        self._faults: dict[str, str] = {}
        for path in filter(None, files):
            self._read(Path(path))
        self.serve(StreamCreateFromSpec, self._create)
        self.serve(StreamDestroy, self._destroy)
        self.serve(ListStreams, self._list)
        self.serve(StreamRegister, self._register)
        self.serve(StreamGetTopic, self._get_topic)
        self.create_timer(period, self._discover_engines, clock=self.wall_clock)
        self._report()

    def _read(self, path: Path) -> None:
        try:
            parsed = parse_specification(path.read_text(encoding='utf-8'))
            for name, specification in specifications_by_sink(parsed).items():
                self._registry.add(CreatedStream(name, str(specification), NO_CONSTRAINTS))
        except OSError as error:
            raise StreamError(
                f'cannot read the streams in {path}: {error.strerror}', ExitCode.NOT_FOUND
            ) from None
        except UnicodeDecodeError:
            raise StreamError(f'cannot read the streams in {path}: it is not in UTF-8') from None
        except DyKnowError as error:
            raise StreamError(f'{path}: {error.message}', error.code) from None

    async def _create(self, request: Any, response: Any) -> None:
        spec = request.spec
        constraints = constraints_from_message(spec.constraints)
        engine = self._choose_engine()
        text = self._registry.text_for(spec.specification, engine)
        stream = CreatedStream(spec.name, spec.specification, constraints, engine)
        self._registry.add(stream)
        try:
            answer = await self._make(stream, engine, text)
        except DyKnowError:
            self._registry.remove(spec.name)
            raise
        response.stream_topic = answer.stream_topic
        response.stream_constraint_violation_topic = answer.stream_constraint_violation_topic

    async def _destroy(self, request: Any, _response: Any) -> None:
        stream = self._registry.remove(request.stream_name)
        if isinstance(stream, CreatedStream) and stream.engine is not None:
            await self._engines[stream.engine].call(StreamDestroy, stream_name=stream.name)
        self._report()

    def _list(self, _request: Any, response: Any) -> None:
        response.stream_names = list(self._registry.names())

    def _register(self, request: Any, _response: Any) -> None:
        for name in ('stream_name', 'topic_name', 'message_type'):
            if not getattr(request, name):
                raise StreamError(f'{name} is empty; a stream needs a name, a topic and its type')
        message_class(request.message_type)
        try:
            validate_topic_name(request.topic_name)
        except InvalidTopicNameException as error:
            raise StreamError(str(error)) from None
        topic = self.resolve_topic_name(request.topic_name)
        self._registry.add(RegisteredStream(request.stream_name, topic, request.message_type))

    def _get_topic(self, request: Any, response: Any) -> None:
        stream = self._registry.find(request.stream_name)
        if not stream.topic:
            raise StreamError(
                f"stream '{stream.name}' waits for a stream processing engine",
                ExitCode.UNAVAILABLE,
            )
        response.topic_name = stream.topic
        response.message_type = stream.message_type

    def _choose_engine(self) -> str:
        engine = self._registry.least_loaded(
            name for name, peer in self._engines.items() if peer.alive
        )
        if engine is None:
            raise engines_missing(self._engines)
        return engine

    async def _make(self, stream: CreatedStream, engine: str, text: str) -> Any:
        spec = StreamCreateFromSpec.Request().spec
        spec.name, spec.specification = stream.name, text
        spec.constraints = constraints_to_message(stream.constraints)
        answer = await self._engines[engine].call(StreamCreateFromSpec, spec=spec)
        self._registry.place(stream.name, engine, answer.stream_topic)
        self._report()
        return answer

    def _discover_engines(self) -> None:
        for name in self._engine_names():
            if name not in self._engines:
                peer = Peer(self, name)
                peer.on_found.append(self._settle)
                peer.on_lost.append(partial(self._engine_lost, name))
                self._engines[name] = peer
        if self._registry.waiting() and any(peer.alive for peer in self._engines.values()):
            self._settle()

    def _engine_names(self) -> Iterable[str]:
        own = self.get_fully_qualified_name()
        for service, types in self.get_service_names_and_types():
            name = service.removesuffix(_ENGINE_SERVICE)
            if name not in (service, own) and _ENGINE_SERVICE_TYPE in types:
                yield name

    def _engine_lost(self, name: str) -> None:
        self.get_logger().warning(f'stream processing engine {name} is gone')
        self._registry.lose(name)
        self._settle()

    def _settle(self) -> None:
        self._unsettled = True
        if not self._settling:
            self._settling = True
            self.spawn(self._settle_streams)

    async def _settle_streams(self) -> None:
        """Adopts the streams that engines have, and places those that wait."""
        while self._unsettled:
            self._unsettled = False
            try:
                for name, peer in list(self._engines.items()):
                    if peer.alive:
                        await self._adopt(name, peer)
                for stream in self._registry.waiting():
                    await self._place(stream)
            except DyKnowError as error:
                # An engine died meanwhile; its loss settles anew.
                self.get_logger().info(str(error))
        self._settling = False
        self._report()

    async def _adopt(self, engine: str, peer: Peer) -> None:
        made = {stream.name for stream in self._registry.made_by(engine)}
        listing = await peer.call(ListStreams)
        waiting = {stream.name for stream in self._registry.waiting()}
        for name in set(listing.stream_names) - made:
            if name not in waiting:
                self._registry.add(CreatedStream(name, None, NO_CONSTRAINTS))
            namespace = engine.rpartition('/')[0]
            self._registry.place(name, engine, f'{namespace}/dyknow/streams/{name}')

    async def _place(self, stream: CreatedStream) -> None:
        if stream.specification is None:
            return
        try:
            engine = self._choose_engine()
            text = self._registry.text_for(stream.specification, engine)
            await self._make(stream, engine, text)
        except DyKnowError as error:
            if error.code in _PASSING:
                self.get_logger().info(f"stream '{stream.name}' cannot be made yet: {error}")
                return
            self._registry.remove(stream.name)
            self._faults[stream.name] = error.message
            self.get_logger().error(f"stream '{stream.name}' cannot be made: {error}")

    def _report(self) -> None:
        waiting = [stream.name for stream in self._registry.waiting()]
        message = f'{len(waiting)} streams wait for an engine' if waiting else RUNNING
        if self._faults:
            message = f'streams that cannot be made: {", ".join(self._faults)}'
        self.set_status(
            message,
            level=DiagnosticStatus.ERROR if self._faults else DiagnosticStatus.OK,
            values={
                'streams': ' '.join(self._registry.names()),
                'waiting': ' '.join(waiting),
                **self._faults,
                'engines': ' '.join(name for name, peer in self._engines.items() if peer.alive),
            },
        )


def main() -> int:
    """The executable stream_manager."""
    return run(StreamManager)
