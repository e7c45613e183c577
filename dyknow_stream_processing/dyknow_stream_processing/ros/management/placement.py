"""Which engine makes which stream: keeps engines and the registry in step, whatever fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, round_time
from dyknow_common.ros import DyKnowNode, constraints_to_message
from dyknow_stream_processing.management.registry import (
    CreatedStream,
    StreamRegistry,
    engines_missing,
)
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.ros.management.engines import Engines
from dyknow_stream_processing.ros.management.keyed_lock import KeyedLock

PATIENCE: Final = 3.0
"""Seconds that a new stream waits for an engine to be there."""

POLL: Final = 0.05
"""Seconds between two looks for one."""

RETRY_PERIOD: Final = 1.0
"""Seconds between two attempts to make what waits."""

_PASSING = (ExitCode.UNAVAILABLE, ExitCode.TIMEOUT, ExitCode.ALREADY_EXISTS)
"""What may go well when it is tried again."""


class Placement:
    """Has engines make the streams of a registry.

    Each stream is changed by one at a time. What an engine was asked for and did not answer is
    noted, and undone once the engine tells that it did it.

    Args:
        on_change: is called when something is not as it was.
    """

    def __init__(
        self,
        node: DyKnowNode,
        registry: StreamRegistry,
        engines: Engines,
        on_change: Callable[[], None],
    ) -> None:
        self.conflicts: dict[tuple[str, str], str] = {}
        self._node = node
        self._registry = registry
        self._engines = engines
        self._on_change = on_change
        self._turns = KeyedLock()
        self._unwanted: set[tuple[str, str]] = set()
        self._settling = False
        self._unsettled = False
        node.create_timer(RETRY_PERIOD, self._retry, clock=node.wall_clock)

    def made_anew(self) -> dict[str, str]:
        """Where and when streams were made anew, by their names."""
        return {
            stream.name: stream.message
            for stream in self._registry.streams()
            if isinstance(stream, CreatedStream) and stream.topic and stream.message
        }

    async def create(self, stream: CreatedStream) -> Any:
        """Has a new stream made; the answer of the engine that makes it.

        Raises:
            DyKnowError: when it cannot be made; nothing is left of it then.
        """
        async with self._turns.of(stream.name):
            self._registry.add(stream)
            try:
                await self._wait_for_engine()
                answer = await self._make(stream)
            except BaseException:
                self._registry.forget(stream.name)
                raise
            finally:
                self._on_change()
        # Others may wait for a stream of this name.
        self.settle()
        return answer

    async def destroy(self, name: str) -> None:
        """Has a stream ended, and forgets it.

        Raises:
            DyKnowError: when there is none, or others are made from it; TIMEOUT when its engine
                does not answer: then it is ended as soon as it does.
        """
        async with self._turns.of(name):
            stream = self._registry.remove(name)
            self._on_change()
            if isinstance(stream, CreatedStream) and stream.engine is not None:
                await self._discard(stream.engine, name)

    def forget_engine(self, engine: str) -> None:
        """Notes that an engine is gone, and with it what was wrong with its streams."""
        self.conflicts = {key: text for key, text in self.conflicts.items() if key[0] != engine}

    def settle(self) -> None:
        """Learns what engines make, and has made what waits; soon, and once for many requests."""
        self._unsettled = True
        if not self._settling and self._node.executor is not None:
            self._settling = True
            self._node.spawn(self._settle)

    def _retry(self) -> None:
        if self._registry.waiting() and self._engines.ready():
            self.settle()

    async def _settle(self) -> None:
        try:
            while self._unsettled:
                self._unsettled = False
                for engine in self._engines.ready():
                    await self._adopt_all(engine)
                self._registry.recognise()
                # What an engine that has not spoken yet makes must not be made a second time.
                if not self._engines.expects_more():
                    await self._place_all()
        finally:
            self._settling = False
            self._on_change()

    async def _adopt_all(self, engine: str) -> None:
        """Learns what an engine makes, and what it makes no more."""
        version = self._registry.version
        try:
            listing = await self._engines.call(engine, ListStreams)
        except DyKnowError as error:
            self._node.get_logger().info(str(error))
            return
        if version != self._registry.version:
            # The list may be older than what has happened meanwhile.
            self._unsettled = self._engines.is_ready(engine)
            return
        listed = frozenset(listing.stream_names)
        self._forget_missing(engine, listed)
        for name, account in sorted(self._engines.report(engine).items()):
            if name in listed and not self._turns.taken(name):
                await self._adopt(engine, account)

    def _forget_missing(self, engine: str, listed: frozenset[str]) -> None:
        for stream in self._registry.made_by(engine):
            if stream.topic and stream.name not in listed and not self._turns.taken(stream.name):
                self._node.get_logger().info(f"stream '{stream.name}' was destroyed at {engine}")
                self._registry.forget(stream.name)
        self._unwanted = {key for key in self._unwanted if key[0] != engine or key[1] in listed}
        self.conflicts = {
            key: text
            for key, text in self.conflicts.items()
            if key[0] != engine or key[1] in listed
        }

    async def _adopt(self, engine: str, account: StreamReport) -> None:
        name = account.name
        told = self._registry.told(
            engine, name, account.specification, account.constraints, account.topic
        )
        known = self._registry.get(name)
        if isinstance(known, CreatedStream) and known.engine == engine:
            return
        if (engine, name) in self._unwanted:
            await self._undo(engine, name)
        elif known is None:
            self._registry.add(told)
        elif isinstance(known, CreatedStream) and known.waits:
            self._adopt_waiting(told)
        elif self._registry.is_copy(told):
            # Its engine was taken for gone, or was found late.
            self._node.get_logger().info(f"{engine} makes '{name}' a second time: it is ended")
            await self._undo(engine, name)
        else:
            self._note_conflict(engine, name)

    def _adopt_waiting(self, told: CreatedStream) -> None:
        if not self._registry.is_copy(told):
            self._node.get_logger().warning(
                f"stream '{told.name}' is made by {told.engine} by another specification than was "
                f'asked for; destroy it to have it made anew'
            )
            self._registry.forget(told.name)
            self._registry.add(told)
            return
        self._registry.take_over(told)

    def _note_conflict(self, engine: str, name: str) -> None:
        known = self._registry.get(name)
        other = getattr(known, 'engine', None) or 'a topic that was registered'
        text = (
            f"there are two streams '{name}': that of {other} is used, that of {engine} is not; "
            f'destroy it there'
        )
        if self.conflicts.get((engine, name)) != text:
            self.conflicts[engine, name] = text
            self._node.get_logger().error(text)

    async def _place_all(self) -> None:
        """Has made what waits, and anew what reads from where nothing is any more."""
        hopeless: set[str] = set()
        progress = True
        while progress:
            progress = False
            for stream in self._registry.outdated():
                progress |= await self._withdraw(stream)
            for stream in self._registry.waiting():
                if stream.name not in hopeless and not self._turns.taken(stream.name):
                    async with self._turns.of(stream.name):
                        made = await self._place(stream.name)
                    progress |= made
                    if not made and self._fails(stream.name):
                        hopeless.add(stream.name)

    def _fails(self, name: str) -> bool:
        return bool(getattr(self._registry.get(name), 'failed', False))

    async def _withdraw(self, stream: CreatedStream) -> bool:
        """Ends a stream whose sources have moved, so that it is made anew."""
        if self._turns.taken(stream.name) or stream.engine is None:
            return False
        async with self._turns.of(stream.name):
            try:
                await self._discard(stream.engine, stream.name)
            except DyKnowError as error:
                self._node.get_logger().info(str(error))
            self._registry.withdraw(stream.name, 'what it is made from has moved')
        return True

    async def _place(self, name: str) -> bool:
        stream = self._registry.get(name)
        if not isinstance(stream, CreatedStream) or not stream.waits:
            return False
        try:
            await self._make(stream)
        except DyKnowError as error:
            failed = error.code not in _PASSING
            if (error.message, failed) != (stream.message, stream.failed):
                log = self._node.get_logger()
                (log.error if failed else log.info)(f"stream '{name}' is not made: {error}")
            self._registry.release(name, error.message, failed=failed)
            return False
        return True

    async def _wait_for_engine(self) -> None:
        """Waits for an engine that was just started, for a while."""
        clock = self._node.wall_clock
        end = clock.now().nanoseconds + round(PATIENCE * SECOND_NS)
        while not self._engines.ready() and clock.now().nanoseconds < end:
            await self._node.deadlines.after(POLL)

    async def _make(self, stream: CreatedStream) -> Any:
        """Has a stream made by the engine with the fewest streams; by another, if that one dies."""
        while True:
            engine = self._registry.least_loaded(self._engines.ready())
            if engine is None:
                raise engines_missing(self._engines.seen())
            try:
                return await self._make_on(stream, engine)
            except DyKnowError as error:
                if error.code is not ExitCode.UNAVAILABLE or self._engines.is_ready(engine):
                    raise

    async def _make_on(self, stream: CreatedStream, engine: str) -> Any:
        name = stream.name
        text, sources = self._registry.text_for(stream, engine)
        self._registry.assign(name, engine)
        try:
            if (engine, name) in self._unwanted:
                await self._discard(engine, name)
            answer = await self._request(stream, engine, text)
        except DyKnowError as error:
            if error.code in (ExitCode.TIMEOUT, ExitCode.UNAVAILABLE):
                # It may do yet what it was asked for.
                self._unwanted.add((engine, name))
            self._registry.release(name, stream.message)
            raise
        when = round_time(self._node.now())
        message = f'made anew on {engine} at {when}: {stream.lost}' if stream.lost else ''
        self._registry.place(name, engine, answer.stream_topic, sources, message)
        self._on_change()
        return answer

    async def _request(self, stream: CreatedStream, engine: str, text: str) -> Any:
        spec = StreamCreateFromSpec.Request().spec
        spec.name, spec.specification = stream.name, text
        spec.constraints = constraints_to_message(stream.constraints)
        answer = await self._engines.call(engine, StreamCreateFromSpec, spec=spec)
        if not self._engines.is_ready(engine):
            raise DyKnowError(f'node {engine} has died', ExitCode.UNAVAILABLE)
        return answer

    async def _undo(self, engine: str, name: str) -> None:
        try:
            await self._discard(engine, name)
        except DyKnowError as error:
            self._node.get_logger().info(str(error))

    async def _discard(self, engine: str, name: str) -> None:
        """Has an engine end a stream; one that is gone has ended it already."""
        try:
            await self._engines.call(engine, StreamDestroy, stream_name=name)
        except DyKnowError as error:
            if error.code in (ExitCode.TIMEOUT, ExitCode.UNAVAILABLE):
                # It may come back, and make it still.
                self._unwanted.add((engine, name))
            if error.code not in (ExitCode.NOT_FOUND, ExitCode.UNAVAILABLE):
                raise
            return
        self._unwanted.discard((engine, name))
