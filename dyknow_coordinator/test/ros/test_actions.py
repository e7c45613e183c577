"""Goals that the coordinator's action servers keep."""

from __future__ import annotations

from typing import Any

import pytest

from dyknow_coordinator.ros import actions


def test_goals_that_have_ended_are_not_kept_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has its request, such as a formula of 1 MB; the default of rclpy is 900 s."""
    given: dict[str, Any] = {}
    monkeypatch.setattr(actions, 'ActionServer', lambda *_, **options: given.update(options))
    monkeypatch.setattr(actions, 'ClientWatch', lambda *_: None)

    class Action:
        """An action type."""

    class Node:
        """A node, as the server sees it."""

        context = reentrant = None

        def get_fully_qualified_name(self) -> str:
            return '/node'

    node: Any = Node()
    actions.CancellingActionServer(node, Action, id)  # type: ignore[arg-type]
    assert given['result_timeout'] <= 60
