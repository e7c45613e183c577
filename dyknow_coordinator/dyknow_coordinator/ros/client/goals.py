"""The goals that a client has sent to the actions of the coordinator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import QoSProfile

from dyknow_common import DyKnowError
from dyknow_common.ros import SERVICE, NodeAdapter, RemoteNode, snake_case
from dyknow_coordinator.ros.client.action_call import ActionCall, ActionCaller, GoalTimeouts


class CoordinatorGoals:
    """Sends goals to the coordinator, with one action client for each action.

    Args:
        node: that sends.
        coordinator: the coordinator.
    """

    def __init__(self, node: NodeAdapter, coordinator: RemoteNode) -> None:
        self._node = node
        self._coordinator = coordinator
        self._actions: dict[Any, ActionCaller] = {}
        self._calls: set[ActionCall] = set()

    def send(
        self,
        action_type: Any,
        goal: Any,
        timeouts: GoalTimeouts,
        on_end: Callable[[Any, DyKnowError | None], None],
        on_feedback: Callable[[Any], None],
    ) -> ActionCall:
        """Send a goal; see `ActionCall`."""

        def end(result: Any, error: DyKnowError | None) -> None:
            self._calls.discard(call)
            on_end(result, error)

        call = ActionCall(
            self._node,
            self._coordinator,
            self._action(action_type),
            goal,
            timeouts,
            on_end=end,
            on_feedback=on_feedback,
        )
        self._calls.add(call)
        return call

    def close(self, error: DyKnowError) -> None:
        """End all calls with an error, also the goals that the coordinator accepts later."""
        calls = list(self._calls)
        for call in calls:
            call.fail(error)
            call.on_answered = lambda: self._destroy_actions(calls)
        self._destroy_actions(calls)

    def _destroy_actions(self, calls: Sequence[ActionCall]) -> None:
        """Destroy the action clients, unless some calls are unanswered.

        A client that is destroyed at once may lose the request to cancel a goal, and cannot cancel
        one that is accepted later. The coordinator would evaluate its formula until its timeout.
        """
        if not any(each.is_unanswered for each in calls):
            while self._actions:
                self._actions.popitem()[1].destroy()

    def _action(self, action_type: Any) -> ActionCaller:
        if action_type not in self._actions:
            self._actions[action_type] = ActionCaller(
                self._node.node,
                action_type,
                f'{self._coordinator.name}/{snake_case(action_type.__name__)}',
                callback_group=MutuallyExclusiveCallbackGroup(),
                goal_service_qos_profile=SERVICE,
                result_service_qos_profile=SERVICE,
                cancel_service_qos_profile=SERVICE,
                feedback_sub_qos_profile=QoSProfile(depth=SERVICE.depth),
            )
        return self._actions[action_type]
