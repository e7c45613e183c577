"""Placement of streams on engines: reconciles the registry with what the engines make.

For example, engine A makes `level` on the topic /a/level, and B makes `half` from it. A dies:

1. The registry marks `level` as lost: it waits for an engine.
2. `ListStreams` asks each live engine for its streams: none may be made twice.
3. B, the live engine with the fewest streams, makes `level` on /b/level.
4. `half` is outdated, as it reads /a/level: B destroys it, and it waits.
5. B makes `half` again, from its own `level`.

If A was only unreachable and reports `level` again, its copy is destroyed.

A stream that an engine makes under a name, but from another specification than was requested, is
never used. It is a conflict: the requested stream is made by an engine in another namespace, as it
would have the same topic in this one, or not at all.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from typing import Any, Final, TypeGuard

from dyknow_interfaces.msg import StreamSpec
from dyknow_interfaces.srv import StreamCreateFromSpec, StreamDestroy
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, round_time
from dyknow_common.ros import DyKnowNode, constraints_to_message, identities_to_message
from dyknow_stream_processing.errors import stream_replaced
from dyknow_stream_processing.management.naming import namespace_of
from dyknow_stream_processing.management.registry import (
    StreamRegistry,
    engines_missing,
    name_taken,
    two_streams,
)
from dyknow_stream_processing.management.streams import CreatedStream, Stream
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.ros.management.engines import Engines

ENGINE_TIMEOUT_NS: Final = 3 * SECOND_NS
FIRST_ENGINE_TIMEOUT_NS: Final = 10 * SECOND_NS
"""Times that a new stream waits for an engine: a system that starts may be busy."""

POLL_PERIOD_S: Final = 0.05
"""Time between two checks for one."""

RETRY_PERIOD_S: Final = 1.0
"""Time between two attempts to make the streams that wait."""

_ANY: Final[Mapping[str, int]] = {}
"""The ids of a reader that accepts any stream on its topics."""

_NO_RESPONSE: Final = (ExitCode.UNAVAILABLE, ExitCode.TIMEOUT)
"""Errors worth retrying, after which an engine may still do what was requested."""


class Placement:
    """Placement of the streams of a registry on engines.

    A request that an engine did not answer is noted, and undone if its reports show later that the
    engine carried it out.

    Args:
        parse: checks a specification, and caches what it says.
        is_kept: returns True if the publishers of a topic keep messages for late subscribers.
        on_change: is called when a stream has changed.
    """

    def __init__(
        self,
        node: DyKnowNode,
        registry: StreamRegistry,
        engines: Engines,
        parse: Callable[[str], Awaitable[object]],
        is_kept: Callable[[str], bool],
        on_change: Callable[[], None],
    ) -> None:
        self.conflicts: dict[tuple[str, str], str] = {}
        """Messages about streams of the name of another one, by engine and stream name."""
        self._node = node
        self._registry = registry
        self._engines = engines
        self._parse = parse
        self._is_kept = is_kept
        self._on_change = on_change
        self._locks = KeyedLock()
        self._unwanted: set[tuple[str, str]] = set()
        # What engines reported and what was requested, if these are the same stream.
        self._compared: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._reconciling = False
        self._reconcile_again = False
        node.create_timer(RETRY_PERIOD_S, self._retry, clock=node.wall_clock)

    async def create(self, stream: CreatedStream, chosen: Mapping[str, int]) -> Any:
        """Create a stream, and return the response of the engine that makes it.

        Args:
            stream: the stream.
            chosen: the ids of streams by their topics; it must be made from these.

        Raises:
            DyKnowError: if it cannot be made; then it is not registered either. UNAVAILABLE, if a
                topic has another stream than was chosen.
        """
        # A request to destroy the stream may come while its specification is parsed.
        async with self._locks.hold(stream.name):
            await self._parse(stream.specification)
            self._registry.add(stream)
            try:
                await self._wait_for_engine()
                response = await self._make(stream, chosen)
            except BaseException:
                self._registry.forget(stream.name)
                raise
            finally:
                self._on_change()
        # Other streams may wait for this one.
        self.reconcile_soon()
        return response

    async def destroy(self, name: str) -> None:
        """Destroy a stream.

        Raises:
            DyKnowError: if there is none, or others are made from it; TIMEOUT if its engine does
                not answer: then the stream is destroyed as soon as the engine reports it.
        """
        async with self._locks.hold(name):
            stream = self._registry.remove(name)
            self._on_change()
            if isinstance(stream, CreatedStream) and stream.engine is not None:
                await self._destroy_on(stream.engine, name)

    def lose_engine(self, engine: str) -> None:
        """Record that an engine is gone: its streams must be recreated, and its conflicts end.

        If it was only unreachable, it makes copies when it returns, which are then unwanted.
        """
        self._unwanted.update((engine, name) for name in self._made_by(engine))
        self._registry.withdraw_all(engine)
        self.conflicts = {key: text for key, text in self.conflicts.items() if key[0] != engine}

    def is_settled(self, engine: str) -> bool:
        """Return True if an engine reports the streams that it is known to make, and no others."""
        reports = self._engines.reports(engine)
        return self._made_by(engine) == reports.keys() and all(
            self._is_compared(engine, report) for report in reports.values()
        )

    def _made_by(self, engine: str) -> set[str]:
        return {stream.name for stream in self._registry.made_by(engine) if stream.topic}

    def identities(self) -> Mapping[str, int]:
        """Return the ids of all streams that engines make, by their topics.

        The id is 0 while it is uncertain whether an engine makes the requested stream there, from
        the requested streams. The report of the engine may not have been compared yet. Or the
        engine may have received samples of a stream that the manager does not know, or that is not
        the stream that the manager knows for this topic.
        """
        made = {each.topic: each for each in self._registry.streams() if _is_made(each)}
        found = {topic: self._reported_id(stream) for topic, stream in made.items()}
        readers: dict[str, list[str]] = {}
        doubtful = [topic for topic, stream_id in found.items() if not stream_id]
        for topic, stream in made.items():
            report = self._engines.reports(str(stream.engine)).get(stream.name)
            for source in report.sources if report else ():
                readers.setdefault(source.topic, []).append(topic)
                # Streams of other systems, such as remote ones, are not in the registry.
                is_own = self._registry.is_stream_topic(source.topic)
                expected = found.get(source.topic, 0 if is_own else source.stream_id)
                if source.stream_id not in (0, expected):
                    doubtful.append(topic)
        for topic in doubtful:  # The list grows in the loop.
            found[topic] = 0
            doubtful += [each for each in readers.pop(topic, ()) if each in found]
        return found

    def _reported_id(self, stream: CreatedStream) -> int:
        """Return the id that an engine reports for a stream; 0 if it may be of another stream."""
        engine, name = str(stream.engine), stream.name
        report = self._engines.reports(engine).get(name)
        if report is None:
            return stream.stream_id
        is_same = self._is_compared(engine, report) and report.topic == stream.topic
        return report.stream_id if is_same else 0

    def _is_compared(self, engine: str, report: StreamReport) -> bool:
        """Return True if a reported stream was found to be the requested one."""
        compared = self._compared.get((engine, report.name), ())
        return compared[:2] == (report.specification, report.constraints)

    def reconcile_soon(self) -> None:
        """Update the registry from the engines and make the streams that wait, soon.

        Simultaneous requests share one run.
        """
        self._reconcile_again = True
        if not self._reconciling and self._node.executor is not None:
            self._reconciling = True
            self._node.spawn(self._reconcile)

    def _retry(self) -> None:
        if self._registry.waiting() and self._engines.ready():
            self.reconcile_soon()

    async def _reconcile(self) -> None:
        try:
            while self._reconcile_again:
                self._reconcile_again = False
                for engine in self._engines.ready():
                    await self._adopt_all(engine)
                self._registry.restore_names()
                # An engine that has not reported yet may already make a stream that waits.
                if not self._engines.awaits_report():
                    await self._place_all()
        finally:
            self._reconciling = False
            self._on_change()

    async def _adopt_all(self, engine: str) -> None:
        """Update the registry with the streams of an engine."""
        version = self._registry.version
        try:
            listed = await self._engines.list_streams(engine, lambda: self._made_by(engine))
        except DyKnowError as error:
            self._node.get_logger().info(str(error))
            return
        if version != self._registry.version:
            # The response may be older than the changes meanwhile.
            self._reconcile_again = self._engines.is_ready(engine)
            return
        self._forget_missing(engine, listed)
        for name, report in sorted(self._engines.reports(engine).items()):
            if name in listed and not self._locks.is_held(name):
                await self._adopt(engine, report)

    def _forget_missing(self, engine: str, listed: frozenset[str]) -> None:
        for stream in self._registry.made_by(engine):
            name = stream.name
            if stream.topic and name not in listed and not self._locks.is_held(name):
                self._node.get_logger().info(f"stream '{name}' was destroyed on {engine}")
                self._registry.forget(name)

        def may_exist(key: tuple[str, str]) -> bool:
            return key[0] != engine or key[1] in listed

        self._unwanted = set(filter(may_exist, self._unwanted))
        self.conflicts = {key: text for key, text in self.conflicts.items() if may_exist(key)}
        self._compared = {key: each for key, each in self._compared.items() if may_exist(key)}

    async def _adopt(self, engine: str, report: StreamReport) -> None:
        """Decide about a stream that an engine makes: register, keep or destroy it."""
        key = engine, report.name
        known = self._registry.get(report.name)
        found = self._registry.reported_stream(engine, report)
        is_unwanted = key in self._unwanted
        if known is None and not is_unwanted:
            self._registry.add(found)
            reported = report.specification, report.constraints
            self._compared[key] = *reported, found.specification, found.constraints
        elif isinstance(known, CreatedStream) and self._is_copy(found, known, report):
            self.conflicts.pop(key, None)
            if known.waits:
                self._registry.adopt(found)
                self._unwanted.discard(key)
            # A copy on another topic may belong to another manager.
            elif known.engine != engine and (is_unwanted or known.topic == found.topic):
                self._node.get_logger().info(f"{engine} makes a copy of '{found.name}', destroyed")
                await self._try_destroy_on(*key)
        elif is_unwanted:
            await self._try_destroy_on(*key)
        elif known is not None:
            await self._note_conflict(engine, found, known)

    def _is_copy(self, found: CreatedStream, known: CreatedStream, report: StreamReport) -> bool:
        """Return True if a reported stream is equivalent to the known one; compared once."""
        key = str(found.engine), found.name
        reported = report.specification, report.constraints
        compared = *reported, known.specification, known.constraints
        if self._compared.get(key) == compared:
            return True
        is_copy = self._registry.is_copy(found)
        if is_copy:
            self._compared[key] = compared
        return is_copy

    async def _note_conflict(self, engine: str, found: CreatedStream, known: Stream) -> None:
        """Report another stream of a known name, and stop using a topic that both are on."""
        shares_topic = known.topic == found.topic
        if isinstance(known, CreatedStream) and (known.waits or shares_topic):
            error = name_taken(known, [found])
        elif shares_topic:
            return  # It was registered under its own name.
        else:
            error = two_streams(known, found)
        if self.conflicts.get((engine, found.name)) != error.message:
            self.conflicts[engine, found.name] = error.message
            self._node.get_logger().error(error.message)
        if isinstance(known, CreatedStream) and known.engine and shares_topic:
            # Whoever reads the topic receives samples of the other stream.
            async with self._locks.hold(found.name):
                if known.engine != engine:
                    await self._try_destroy_on(known.engine, found.name)
                self._registry.withdraw(found.name, error.message, failed=True)
            for stream in self._registry.outdated():
                await self._withdraw(stream)

    async def _place_all(self) -> None:
        """Make the streams that wait; recreate streams whose sources have another topic."""
        failed: set[str] = set()
        progress = True
        while progress:
            progress = False
            for stream in self._registry.outdated():
                progress |= await self._withdraw(stream)
            for name in [stream.name for stream in self._registry.waiting()]:
                if name in failed or self._locks.is_held(name):
                    continue
                async with self._locks.hold(name):
                    placed = await self._place(name)
                progress |= placed
                if not placed and getattr(self._registry.get(name), 'failed', False):
                    failed.add(name)

    async def _withdraw(self, stream: CreatedStream) -> bool:
        """Destroy a stream whose sources have another topic, for it to be recreated."""
        if self._locks.is_held(stream.name) or stream.engine is None:
            return False
        async with self._locks.hold(stream.name):
            await self._try_destroy_on(stream.engine, stream.name)
            self._registry.withdraw(stream.name, 'a stream that it is made from has another topic')
        return True

    async def _place(self, name: str) -> bool:
        """Make a stream if it waits, and return True on success."""
        stream = self._registry.get(name)
        if not isinstance(stream, CreatedStream) or not stream.waits:
            return False
        try:
            await self._make(stream)
        except DyKnowError as error:
            failed = error.code not in _NO_RESPONSE
            if (error.message, failed) != (stream.message, stream.failed):
                logger = self._node.get_logger()
                text = f"stream '{name}' is not made: {error}"
                # A logger of rclpy has one severity for each call in the code.
                if failed:
                    logger.error(text)  # noqa: TRY400 - no fault of DyKnow
                else:
                    logger.info(text)
            self._registry.release(name, error.message, failed=failed)
            return False
        return True

    async def _wait_for_engine(self) -> None:
        """Wait until an engine is ready, at most for the timeout."""
        clock = self._node.wall_clock
        deadline = clock.now().nanoseconds
        deadline += ENGINE_TIMEOUT_NS if self._engines.remotes else FIRST_ENGINE_TIMEOUT_NS
        while not self._engines.ready() and clock.now().nanoseconds < deadline:
            await self._node.deadlines.after(POLL_PERIOD_S)

    async def _make(self, stream: CreatedStream, chosen: Mapping[str, int] = _ANY) -> Any:
        """Make a stream on the engine with the fewest streams; on another if that one dies.

        An engine that has the last value of a kept topic is preferred. No engine is asked whose
        namespace has another stream of the name: both would be published on one topic.
        """
        others = await self._others(stream)
        while True:
            taken = {namespace_of(engine) for engine in others}
            ready = self._engines.ready()
            free = [each for each in ready if namespace_of(each) not in taken]
            keepers = self._registry.keepers(stream, self._is_kept)
            preferred = [each for each in free if each in keepers]
            engine = self._registry.least_loaded(preferred or free)
            if engine is None and ready:
                raise name_taken(stream, others.values())
            if engine is None:
                namespaces = self._registry.engine_namespaces
                raise engines_missing(self._engines.remotes, namespaces)
            try:
                return await self._make_on(stream, engine, chosen)
            except DyKnowError as error:
                if error.code is not ExitCode.UNAVAILABLE or self._engines.is_ready(engine):
                    raise

    async def _others(self, stream: CreatedStream) -> dict[str, CreatedStream]:
        """Return other streams of the name of a requested stream, by the engines that make them."""
        others = {}
        for engine in self._engines.ready():
            report = self._engines.reports(engine).get(stream.name)
            if report is None or (engine, stream.name) in self._unwanted:
                continue
            # The report may be older than the destruction of the stream.
            if await self._engines.may_make(engine, stream.name):
                others[engine] = self._registry.reported_stream(engine, report)
        return others

    async def _make_on(self, stream: CreatedStream, engine: str, chosen: Mapping[str, int]) -> Any:
        name = stream.name
        text, sources = self._registry.text_for(stream, engine)
        identities = self._chosen_sources(sources.values(), chosen)
        self._registry.assign(name, engine)
        try:
            if (engine, name) in self._unwanted:
                await self._destroy_on(engine, name)
            response = await self._request(stream, engine, text, identities)
        except DyKnowError as error:
            if error.code in _NO_RESPONSE:
                self._unwanted.add((engine, name))
            self._registry.release(name, stream.message)
            raise
        time = round_time(self._node.now())
        message = f'recreated on {engine} at {time}: {stream.lost}' if stream.lost else ''
        known = stream.specification, stream.constraints
        self._compared[engine, name] = text, stream.constraints, *known
        self._registry.place(
            name, engine, response.stream_topic, sources, message, response.stream_id
        )
        self._on_change()
        return response

    def _chosen_sources(
        self, topics: Iterable[str], chosen: Mapping[str, int]
    ) -> Mapping[str, int]:
        """Return the ids of streams that a new stream must be made from, by their topics.

        Raises:
            StreamError: UNAVAILABLE, if a chosen stream is known to be another one now.
        """
        known = self.identities()
        for topic, stream_id in chosen.items():
            if known.get(topic, stream_id) != stream_id:
                raise stream_replaced(topic)
        return {topic: known.get(topic, 0) for topic in topics} | dict(chosen)

    async def _request(
        self, stream: CreatedStream, engine: str, text: str, sources: Mapping[str, int]
    ) -> Any:
        constraints = constraints_to_message(stream.constraints)
        spec = StreamSpec(name=stream.name, specification=text, constraints=constraints)
        response = await self._engines.remotes[engine].call(
            StreamCreateFromSpec,
            spec=spec,
            sources=identities_to_message(sources),
            is_recreated=bool(stream.lost),
        )
        if not self._engines.is_ready(engine):
            raise DyKnowError(f'node {engine} has died or was stopped', ExitCode.UNAVAILABLE)
        self._engines.discard_report(engine, stream.name)
        return response

    async def _try_destroy_on(self, engine: str, name: str) -> None:
        try:
            await self._destroy_on(engine, name)
        except DyKnowError as error:
            self._node.get_logger().info(str(error))

    async def _destroy_on(self, engine: str, name: str) -> None:
        """Have an engine destroy a stream; succeed if the engine or the stream is gone."""
        try:
            await self._engines.remotes[engine].call(StreamDestroy, stream_name=name)
        except DyKnowError as error:
            if error.code in _NO_RESPONSE:
                self._unwanted.add((engine, name))
            if error.code not in (ExitCode.NOT_FOUND, ExitCode.UNAVAILABLE):
                raise
            if error.code is ExitCode.UNAVAILABLE:
                return
        self._unwanted.discard((engine, name))
        self._engines.discard_report(engine, name)


def _is_made(stream: Stream) -> TypeGuard[CreatedStream]:
    return isinstance(stream, CreatedStream) and bool(stream.topic)


class KeyedLock:
    """Locks by name; a coroutine that holds one awaits services meanwhile."""

    def __init__(self) -> None:
        self._held: dict[str, Future] = {}

    def is_held(self, name: str) -> bool:
        """Return True if a coroutine holds the lock of a name."""
        return name in self._held

    @asynccontextmanager
    async def hold(self, name: str) -> AsyncIterator[None]:
        """Acquire the lock of a name, and release it at the end of the block."""
        while name in self._held:
            await self._held[name]
        released = self._held[name] = Future()
        try:
            yield
        finally:
            del self._held[name]
            released.set_result(None)
