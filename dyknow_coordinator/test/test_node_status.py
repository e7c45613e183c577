"""The diagnosis of nodes that the coordinator depends on."""

import pytest

from dyknow_coordinator import Level
from dyknow_coordinator.reporting.node_status import NodeState, diagnose_node

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ('state', 'level', 'text'),
    [
        (NodeState(alive=True, message='running'), Level.OK, 'running'),
        (NodeState(alive=True, level=Level.ERROR, message='x'), Level.ERROR, 'x'),
        (NodeState(absent=SECOND), Level.WARN, 'not found yet'),
        (NodeState(absent=9 * SECOND), Level.ERROR, 'not found within 9 s: is it running'),
        (NodeState(message='running', absent=2 * SECOND), Level.ERROR, 'gone for 2 s: it was st'),
    ],
)
def test_nodes(state: NodeState, level: Level, text: str) -> None:
    diagnosis = diagnose_node(state)
    assert diagnosis.level is level
    assert diagnosis.text.startswith(text)
