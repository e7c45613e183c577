"""The diagnostics of a guard."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from dyknow_common.ros import DiagnosticsPublisher, DyKnowNode
from dyknow_configuration import RequestedGuard
from dyknow_reactions.guard.gate import Gate, GateState


class GuardDiagnostics:
    """Publisher of the state of a guard on `/diagnostics`.

    Args:
        node: the guard.
        guard: its description.
    """

    def __init__(self, node: DyKnowNode, guard: RequestedGuard) -> None:
        self._node = node
        self._guard = guard
        self._diagnostics = DiagnosticsPublisher(node)

    def publish(self, gate: Gate, passed: int, refused: int, bypass: str) -> None:
        """Publish the state; `bypass` says who can publish the output beside the guard."""
        level, text = DiagnosticStatus.OK, 'open'
        if gate.state is not GateState.OPEN:
            level, text = DiagnosticStatus.ERROR, f'{gate.state.name.lower()}: {gate.reason}'
        elif bypass:
            level, text = DiagnosticStatus.WARN, bypass
        counts = {
            'input': self._guard.input,
            'output': self._guard.output,
            'passed': str(passed),
            'refused': str(refused),
        }
        values = [KeyValue(key=key, value=value) for key, value in counts.items()]
        name = self._node.get_fully_qualified_name()
        status = DiagnosticStatus(level=level, name=name, message=text, values=values)
        self._diagnostics.publish([status])
