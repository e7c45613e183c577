"""The status of the latest goal of an action."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final
from uuid import UUID

from dyknow_common import SECOND_NS, Value
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.sample import WholeMessage
from dyknow_stream_processing.violation import Fault, ViolationKind

STATUS_NAMES: Final = (
    'UNKNOWN',
    'ACCEPTED',
    'EXECUTING',
    'CANCELING',
    'SUCCEEDED',
    'CANCELED',
    'ABORTED',
)
"""The names of the constants of action_msgs/msg/GoalStatus, by their values."""


class ActionStatusOperator(Operator):
    """The status of the goal that was accepted last, whenever the server publishes statuses."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Emit the status of the latest goal in a message; a message may have none."""
        try:
            goals = [(_accepted_at(each), each) for each in _goals(fields)]
            if goals:
                # The last of several goals with one stamp.
                latest = max(reversed(goals), key=lambda goal: goal[0])[1]
                self._emit(valid_time, _status_fields(latest), watermark, now)
                return
        except (AttributeError, TypeError, ValueError):
            message = f'a message of {self.inputs[0].label} is no action_msgs/msg/GoalStatusArray'
            self._reject(Fault(ViolationKind.FIELDS, valid_time, message))
        self.promise(port, watermark, now)

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return that there is no goal, unless messages cannot be read."""
        return super().obstacle(name) if self.dropped_for else f'{name(self)} has no goal'


def _goals(fields: Mapping[str, Value]) -> Any:
    if not isinstance(fields, WholeMessage):
        raise TypeError
    return fields.message.status_list


def _accepted_at(goal: Any) -> int:
    stamp = goal.goal_info.stamp
    return int(stamp.sec * SECOND_NS + stamp.nanosec)


def _status_fields(goal: Any) -> Mapping[str, Value]:
    status = int(goal.status)
    return {
        'status': status,
        'name': STATUS_NAMES[status if 0 <= status < len(STATUS_NAMES) else 0],
        'goal_id': str(UUID(bytes=bytes(goal.goal_info.goal_id.uuid))),
    }
