"""The snapshot service of rosbag2, in the place of the memory of the recorder."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import SERVICE, DyKnowNode

_TIMEOUT_S = 30.0


class SnapshotService:
    """Client of the service by which a recorder of rosbag2 writes what it has in memory.

    Args:
        node: the node.
        name: of the service.

    Raises:
        DyKnowError: UNAVAILABLE, if the type of the service is not installed.
    """

    def __init__(self, node: DyKnowNode, name: str) -> None:
        try:
            self._type = import_module('rosbag2_interfaces.srv').Snapshot
        except (ImportError, AttributeError):
            raise DyKnowError(
                f"snapshot_service is '{name}', but its type rosbag2_interfaces/srv/Snapshot is "
                'not installed; install ros-jazzy-rosbag2-interfaces, or leave out the parameter',
                ExitCode.UNAVAILABLE,
            ) from None
        self._node = node
        self._name = name
        self._client = node.create_client(
            self._type, name, qos_profile=SERVICE, callback_group=node.reentrant
        )

    async def take(self) -> None:
        """Have the snapshot written.

        Raises:
            DyKnowError: UNAVAILABLE, if that fails.
        """
        if not self._client.service_is_ready():
            raise DyKnowError(f'there is no service {self._name}', ExitCode.UNAVAILABLE)
        answer: Any = self._client.call_async(self._type.Request())
        late = DyKnowError(f'{self._name} has not answered', ExitCode.TIMEOUT)
        self._node.deadlines.fail(answer, _TIMEOUT_S, late)
        response = await answer
        if not response.success:
            raise DyKnowError(f'{self._name} has failed to write', ExitCode.UNAVAILABLE)
