"""The stream processing engines on the graph: found by their services, known by their reports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED, NO_SUBSCRIPTION_EVENTS, DyKnowNode, RemoteNode
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message

INTRODUCTION: Final = 3.0
"""Seconds within which an engine that was found says what it makes."""

_SERVICES: Final = (StreamCreateFromSpec, StreamDestroy, ListStreams)
_SERVICE = '/stream_create_from_spec'
_SERVICE_TYPE = 'dyknow_interfaces/srv/StreamCreateFromSpec'
# Managers make streams too, by having engines make them; by this service they are told apart.
_MANAGER_SERVICE = '/stream_get_topic'


class Engines:
    """All stream processing engines, in any namespace.

    Args:
        period: seconds between two looks for new ones.
        on_report: is told the name of an engine that has reported its streams.
        on_lost: is told the name of an engine that is gone.
    """

    def __init__(
        self,
        node: DyKnowNode,
        period: float,
        on_report: Callable[[str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._node = node
        self._on_report = on_report
        self._on_lost = on_lost
        self._peers: dict[str, RemoteNode] = {}
        self._found: dict[str, int] = {}
        self._reports: dict[str, Mapping[str, StreamReport]] = {}
        node.create_timer(period, self._discover, clock=node.wall_clock)

    def seen(self) -> tuple[str, ...]:
        """The names of all engines that were ever found."""
        return tuple(self._peers)

    def ready(self) -> tuple[str, ...]:
        """The engines that live, and whose streams are known."""
        return tuple(filter(self.is_ready, self._peers))

    def is_ready(self, name: str) -> bool:
        """Whether an engine lives and its streams are known."""
        return self._peers[name].alive and name in self._reports

    def expects_more(self) -> bool:
        """Whether an engine that was just found has yet to say what it makes."""
        now = self._node.wall_clock.now().nanoseconds
        return any(
            now - found < INTRODUCTION * SECOND_NS and not self.is_ready(name)
            for name, found in self._found.items()
        )

    def report(self, name: str) -> Mapping[str, StreamReport]:
        """What an engine said last of its streams, by their names."""
        return self._reports.get(name, {})

    async def call(self, name: str, service_type: Any, **fields: Any) -> Any:
        """The response of an engine's service.

        Raises:
            DyKnowError: as `RemoteNode.call` does.
        """
        return await self._peers[name].call(service_type, **fields)

    def _discover(self) -> None:
        for name in self._names():
            if name not in self._peers:
                self._meet(name)

    def _meet(self, name: str) -> None:
        peer = RemoteNode(self._node, name, services=_SERVICES)
        peer.on_found.append(partial(self._note_found, name))
        peer.on_lost.append(partial(self._note_lost, name))
        self._peers[name] = peer
        self._note_found(name)
        self._node.create_subscription(
            StreamStatusArray,
            f'{name}/streams',
            partial(self._note_report, name),
            LATCHED,
            callback_group=self._node.reentrant,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def _names(self) -> Iterable[str]:
        services = dict(self._node.get_service_names_and_types())
        for service, types in services.items():
            name = service.removesuffix(_SERVICE)
            if (
                name != service
                and _SERVICE_TYPE in types
                and f'{name}{_MANAGER_SERVICE}' not in services
            ):
                yield name

    def _note_found(self, name: str) -> None:
        self._found[name] = self._node.wall_clock.now().nanoseconds
        if name in self._reports:
            self._on_report(name)

    def _note_lost(self, name: str) -> None:
        # What it said last is no more: whether it comes back with it, its next report tells.
        self._reports.pop(name, None)
        self._on_lost(name)

    def _note_report(self, name: str, report: Any) -> None:
        accounts = map(report_from_message, report.streams)
        self._reports[name] = {account.name: account for account in accounts}
        if self._peers[name].alive:
            self._on_report(name)
