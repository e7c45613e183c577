"""The stream processing engines on the ROS graph: known by their status and their reports.

For example, the manager `/robot1/stream_manager` starts:

    services   /robot1/stream_processing_engine, /robot1/stream_manager and the node /robot2/e offer
               StreamCreateFromSpec; /robot2/e is in another namespace
    status     /robot1/stream_processing_engine has the type of an engine
    report     /robot1/stream_processing_engine reports its streams: from now on it is given streams
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS, DyKnowError
from dyknow_common.ros import (
    NODE_TYPE,
    DyKnowNode,
    RemoteNode,
    time_to_nanoseconds,
)
from dyknow_stream_processing.management.naming import Namespaces
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message

ENGINE_TYPE: Final = 'stream_processing_engine'
"""The type that an engine has in its status."""

FIRST_REPORT_TIMEOUT_NS: Final = 3 * SECOND_NS
"""Time within which a node that was found has reported, if it is an engine."""

_SERVICES: Final = (StreamCreateFromSpec, StreamDestroy, ListStreams)
_SERVICE: Final = '/stream_create_from_spec'
_SERVICE_TYPE: Final = 'dyknow_interfaces/srv/StreamCreateFromSpec'


class Engines:
    """The stream processing engines that a manager uses.

    A node is an engine if its status says so. Its services do not tell: discovery delivers them one
    after the other, and a stream manager offers an engine's services, too.

    Args:
        discovery_period_s: seconds between two searches for new engines.
        on_report: is called with the name of an engine that has reported its streams.
        on_lost: is called with the name of an engine that is gone.
    """

    def __init__(
        self,
        node: DyKnowNode,
        namespaces: Namespaces,
        discovery_period_s: float,
        on_report: Callable[[str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.remotes: dict[str, RemoteNode] = {}
        """All engines that were ever found, by name."""
        self._node = node
        self._namespaces = namespaces
        self._on_report = on_report
        self._on_lost = on_lost
        # Nodes that offer the services of engines.
        self._candidates: dict[str, RemoteNode] = {}
        self._found_at: dict[str, int] = {}
        self._reports: dict[str, dict[str, StreamReport]] = {}
        self._known_until: dict[str, int] = {}
        # Engines of this process exist by now: the first of them need not wait for a period.
        node.deadlines.after(0.0).add_done_callback(lambda _: self._discover())
        node.create_timer(discovery_period_s, self._discover, clock=node.wall_clock)

    def ready(self) -> tuple[str, ...]:
        """Return the engines that are alive and have reported their streams."""
        return tuple(filter(self.is_ready, self.remotes))

    def is_ready(self, name: str) -> bool:
        """Return True if an engine is alive and has reported its streams."""
        return name in self._reports and self.remotes[name].alive

    def awaits_report(self) -> bool:
        """Return True while a node that was just found may be an engine with streams."""
        earliest = self._node.wall_clock.now().nanoseconds - FIRST_REPORT_TIMEOUT_NS
        return any(
            found_at > earliest
            and not self.is_ready(name)
            and self._type(name) in ('', ENGINE_TYPE)
            for name, found_at in self._found_at.items()
        )

    def reports(self, name: str) -> Mapping[str, StreamReport]:
        """Return the latest reports of an engine, by stream name."""
        return self._reports.get(name, {})

    def known_until(self) -> int:
        """Return the time until which all engines have reported their topics, in nanoseconds."""
        return min((self._known_until[name] for name in self.ready()), default=self._node.now())

    def discard_report(self, name: str, stream: str) -> None:
        """Discard the report of a stream that an engine has just made or destroyed."""
        self._reports.get(name, {}).pop(stream, None)

    async def list_streams(self, name: str, made: Callable[[], set[str]]) -> frozenset[str]:
        """Return the streams that an engine makes.

        An engine that has just been restarted has none: they are lost, and nobody destroyed them.

        Args:
            name: the name of the engine.
            made: returns the streams that it is known to make at present.

        Raises:
            DyKnowError: if it does not answer, or was restarted.
        """
        before = made()
        response = await self.remotes[name].call(ListStreams)
        listed = frozenset(response.stream_names)
        # Streams that were made or destroyed meanwhile are not missing.
        if (before & made()) - listed:
            await self.remotes[name].confirm_run()
        return listed

    async def may_make(self, name: str, stream: str) -> bool:
        """Return True if an engine answers that it makes a stream, or does not answer."""
        try:
            response = await self.remotes[name].call(ListStreams)
        except DyKnowError:
            return True
        return stream in response.stream_names

    def _discover(self) -> None:
        own = self._node.get_fully_qualified_name()
        for service, types in self._node.get_service_names_and_types():
            name = service.removesuffix(_SERVICE)
            if name in (service, own) or name in self._candidates or _SERVICE_TYPE not in types:
                continue
            if self._namespaces.contain(name):
                self._add(name)

    def _add(self, name: str) -> None:
        remote = RemoteNode(self._node, name, services=_SERVICES)
        remote.on_found.append(partial(self._on_node_found, name))
        remote.on_lost.append(partial(self._on_node_lost, name))
        self._candidates[name] = remote
        self._note_found(name)

    def _note_found(self, name: str) -> None:
        self._found_at[name] = self._node.wall_clock.now().nanoseconds

    def _type(self, name: str) -> str:
        """Return the type of a node; empty if its status is unknown or does not say it."""
        return self._candidates[name].status.get(NODE_TYPE, '')

    def _on_node_found(self, name: str) -> None:
        type_ = self._type(name)
        if type_ != ENGINE_TYPE:
            if not type_:
                self._node.get_logger().warning(
                    f"node {name} is not used: its status has no '{NODE_TYPE}'; an engine says "
                    f"'{ENGINE_TYPE}' there"
                )
            return
        self._note_found(name)
        if name not in self.remotes:
            self.remotes[name] = self._candidates[name]
            self._node.create_report_subscription(
                StreamStatusArray,
                f'{name}/streams',
                partial(self._on_message, name),
                callback_group=self._node.reentrant,
            )
        elif name in self._reports:
            self._on_report(name)

    def _on_node_lost(self, name: str) -> None:
        if name in self.remotes:
            # Its latest report is outdated; if it comes back, it sends a new one.
            self._reports.pop(name, None)
            self._on_lost(name)

    def _on_message(self, name: str, message: Any) -> None:
        if self._type(name) != ENGINE_TYPE:
            return  # Another kind of node has taken its name.
        self._known_until[name] = time_to_nanoseconds(message.stamp)
        self._reports[name] = {each.name: report_from_message(each) for each in message.streams}
        if self.remotes[name].alive:
            self._on_report(name)
