"""The start of a system: which nodes run, and what they have loaded."""

from __future__ import annotations

import os
import time
from collections.abc import Collection
from functools import partial
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dyknow_bringup.errors import BringupError
from dyknow_common import SECOND_NS, ExitCode, round_duration
from dyknow_common.executables import interruptible
from dyknow_common.ros import STATUS, TICK_PERIOD_S, start_ros, started_at
from dyknow_coordinator import has_loaded

_NAME = 'dyknow_up'


class SystemStart:
    """The statuses of the nodes of a system that starts, received in a `with` block.

    Args:
        namespace: the namespace of the system, absolute.
        nodes: the names of its nodes.
        since: when it starts, in nanoseconds: nodes that are older belong to another system.
    """

    def __init__(self, namespace: str, nodes: Collection[str], since: int = 0) -> None:
        self._namespace = namespace
        self._nodes = nodes
        self._since = since
        self._values: dict[str, dict[str, str]] = {}

    def __enter__(self) -> Self:
        enclave = f'{self._namespace.rstrip("/")}/{_NAME}'
        start_ros(['--ros-args', '--enclave', enclave])
        self._node = Node(_NAME, namespace=self._namespace, start_parameter_services=False)
        for name in self._nodes:
            self._node.create_subscription(
                DiagnosticStatus,
                f'{self._namespace.rstrip("/")}/{name}/_status',
                partial(self._on_status, name),
                STATUS,
            )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def spin_once(self, timeout_s: float) -> None:
        """Wait for a status."""
        self._executor.spin_once(timeout_sec=timeout_s)

    @property
    def missing(self) -> list[str]:
        """The nodes that have not published their status."""
        return [name for name in self._nodes if name not in self._values]

    @property
    def is_complete(self) -> bool:
        """True if all nodes run, and have checked everything that they have loaded."""
        return not self.missing and has_loaded(self._values)

    def __str__(self) -> str:
        if self.missing:
            is_off = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'OFF'
            hint = ', as ROS_AUTOMATIC_DISCOVERY_RANGE=OFF hides other processes' if is_off else ''
            return (
                f'DyKnow does not run completely in {self._namespace}: '
                f'no status of {", ".join(self.missing)}{hint}'
            )
        ontology = self._values['ontology_manager']
        contents = ', '.join(
            _counted(ontology[things], things) for things in ('concepts', 'features', 'objects')
        )
        semantics = self._values['stream_semantics_manager']
        streams = self._values['stream_manager']
        waiting = len(streams['waiting'].split())
        refused = int(semantics.get('refused', '0'))
        accepted = str(int(semantics['annotations']) - refused)
        numbers = (
            ontology['files'],
            semantics['annotations'],
            streams['streams'],
            streams['refused'],
        )
        if set(numbers) == {'0'} and streams['engines'] and not waiting:
            return f'DyKnow runs in {self._namespace}: no ontology, annotation or stream is loaded'
        return f'DyKnow runs in {self._namespace}: ' + ', '.join(
            (
                f'{_counted(ontology["files"], "ontologies")} ({contents})',
                _counted(accepted, 'annotations'),
                f'{refused} refused' if 'refused' in semantics else 'not checked yet',
                _counted(streams['streams'], 'streams'),
                *([f'{waiting} waiting'] if waiting else []),
                *([] if streams['engines'] else ['no engine found yet']),
                f'{streams["refused"]} refused',
            )
        )

    def _on_status(self, name: str, status: Any) -> None:
        if started_at(status) >= self._since:
            self._values[name] = {each.key: each.value for each in status.values}


def wait_for_start(namespace: str, nodes: Collection[str], timeout: int) -> str:
    """Wait until the nodes of a system are ready; return what they have loaded.

    Args:
        namespace: the namespace of the system, absolute.
        nodes: the names of its nodes.
        timeout: nanoseconds.

    Raises:
        BringupError: UNAVAILABLE, if they are not ready in time.
    """
    end = time.monotonic() + timeout / SECOND_NS
    with interruptible(), SystemStart(namespace, nodes) as start:
        while not start.is_complete:
            if time.monotonic() > end:
                text = f'{start}; it is not ready within {round_duration(timeout)}'
                raise BringupError(text, ExitCode.UNAVAILABLE)
            start.spin_once(TICK_PERIOD_S)
        return str(start)


def where_coordinators_are(node: Node, name: str) -> str:
    """Return what to do if the named coordinator is not on the ROS graph; empty if it is."""
    services = [
        service
        for service, types in node.get_service_names_and_types()
        if 'dyknow_interfaces/srv/EvaluateFormula' in types and node.count_services(service)
    ]
    found = sorted(service.rpartition('/')[0] for service in services)
    if node.resolve_service_name(name) in found:
        return ''
    if found:
        return f'; there are: {", ".join(found)} (choose one by --coordinator)'
    return '; does DyKnow run, in this namespace and ROS domain? "dyknow up" starts it'


def _counted(number: str, things: str) -> str:
    """Return `1 ontology`, `2 ontologies`."""
    singular = 'ontology' if things == 'ontologies' else things.removesuffix('s')
    return f'{number} {singular if number == "1" else things}'
