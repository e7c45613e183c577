"""The stream processing engines on the ROS graph: found by their services, known by reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import ListStreams, StreamCreateFromSpec, StreamDestroy

from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED, DyKnowNode, RemoteNode
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message

FIRST_REPORT_TIMEOUT_NS: Final = 3 * SECOND_NS
"""Time within which an engine that was found reports its streams."""

_SERVICES: Final = (StreamCreateFromSpec, StreamDestroy, ListStreams)
_SERVICE: Final = '/stream_create_from_spec'
_SERVICE_TYPE: Final = 'dyknow_interfaces/srv/StreamCreateFromSpec'
_MANAGER_SERVICE: Final = '/stream_get_topic'
"""Managers offer the services of engines, too; only they offer this one."""


class Engines:
    """All stream processing engines, in any namespace.

    Args:
        discovery_period_s: seconds between two searches for new engines.
        on_report: is called with the name of an engine that has reported its streams.
        on_lost: is called with the name of an engine that is gone.
    """

    def __init__(
        self,
        node: DyKnowNode,
        discovery_period_s: float,
        on_report: Callable[[str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.remotes: dict[str, RemoteNode] = {}
        """All engines that were ever found, by name."""
        self._node = node
        self._on_report = on_report
        self._on_lost = on_lost
        self._found_at: dict[str, int] = {}
        self._reports: dict[str, Mapping[str, StreamReport]] = {}
        node.create_timer(discovery_period_s, self._discover, clock=node.wall_clock)

    def ready(self) -> tuple[str, ...]:
        """Return the engines that are alive and have reported their streams."""
        return tuple(filter(self.is_ready, self.remotes))

    def is_ready(self, name: str) -> bool:
        """Return True if an engine is alive and has reported its streams."""
        return self.remotes[name].alive and name in self._reports

    def awaits_report(self) -> bool:
        """Return True while an engine that was just found has yet to report its streams."""
        earliest = self._node.wall_clock.now().nanoseconds - FIRST_REPORT_TIMEOUT_NS
        return any(
            found_at > earliest and not self.is_ready(name)
            for name, found_at in self._found_at.items()
        )

    def reports(self, name: str) -> Mapping[str, StreamReport]:
        """Return the latest reports of an engine, by stream name."""
        return self._reports.get(name, {})

    def _discover(self) -> None:
        services = dict(self._node.get_service_names_and_types())
        for service, types in services.items():
            name = service.removesuffix(_SERVICE)
            is_manager = f'{name}{_MANAGER_SERVICE}' in services
            if name == service or _SERVICE_TYPE not in types or is_manager:
                continue
            if name not in self.remotes:
                self._add(name)

    def _add(self, name: str) -> None:
        remote = RemoteNode(self._node, name, services=_SERVICES)
        remote.on_found.append(partial(self._on_engine_found, name))
        remote.on_lost.append(partial(self._on_engine_lost, name))
        self.remotes[name] = remote
        self._on_engine_found(name)
        self._node.create_subscription(
            StreamStatusArray,
            f'{name}/streams',
            partial(self._on_message, name),
            LATCHED,
            callback_group=self._node.reentrant,
        )

    def _on_engine_found(self, name: str) -> None:
        self._found_at[name] = self._node.wall_clock.now().nanoseconds
        if name in self._reports:
            self._on_report(name)

    def _on_engine_lost(self, name: str) -> None:
        # Its latest report is outdated; if it comes back, it sends a new one.
        self._reports.pop(name, None)
        self._on_lost(name)

    def _on_message(self, name: str, message: Any) -> None:
        self._reports[name] = {each.name: report_from_message(each) for each in message.streams}
        if self.remotes[name].alive:
            self._on_report(name)
