"""Results and progress reports of the reasoning engine."""

from __future__ import annotations

from typing import Any, Final, Protocol

from dyknow_interfaces.msg import FormulaProgress, FormulaResult

from dyknow_common.ros import LATCHED_HISTORY, DyKnowNode

_MAX_UNCLAIMED: Final = 1000
_PROGRESS_DEPTH: Final = 1000


class ResultListener(Protocol):
    """Receiver of the result and the progress of one formula."""

    def receive_result(self, result: Any) -> None:
        """Receive a FormulaResult message."""

    def receive_progress(self, progress: Any) -> None:
        """Receive a FormulaProgress message."""


class Results:
    """Passes results and progress reports to the listeners of their formulas.

    Args:
        progress_topic: of the reasoning engine.
    """

    def __init__(self, node: DyKnowNode, progress_topic: str) -> None:
        # Each run of the coordinator has its own topic: results of former runs are obsolete.
        self.topic = f'{node.get_fully_qualified_name()}/results_{node.started_at:x}'
        self._listeners: dict[tuple[int, int], ResultListener] = {}
        # A result may arrive before the response that contains the id of its formula.
        self._unclaimed: dict[tuple[int, int], Any] = {}
        subscriptions = (
            (FormulaResult, self.topic, self._on_result, LATCHED_HISTORY),
            (FormulaProgress, progress_topic, self._on_progress, _PROGRESS_DEPTH),
        )
        for message_type, topic, callback, quality_of_service in subscriptions:
            node.create_subscription(
                message_type, topic, callback, quality_of_service, callback_group=node.reentrant
            )

    def register(self, group_id: int, formula_id: int, listener: ResultListener) -> None:
        """Register the listener of a formula; it gets a result that has already arrived."""
        key = group_id, formula_id
        self._listeners[key] = listener
        if key in self._unclaimed:
            listener.receive_result(self._unclaimed.pop(key))

    def unregister(self, group_id: int, formula_id: int) -> None:
        """Remove the listener of a formula."""
        self._listeners.pop((group_id, formula_id), None)

    def _on_result(self, result: Any) -> None:
        key = result.formula_group_id, result.formula_id
        if key in self._listeners:
            self._listeners[key].receive_result(result)
            return
        self._unclaimed[key] = result
        if len(self._unclaimed) > _MAX_UNCLAIMED:
            del self._unclaimed[next(iter(self._unclaimed))]

    def _on_progress(self, progress: Any) -> None:
        listener = self._listeners.get((progress.formula_group_id, progress.formula_id))
        if listener is not None:
            listener.receive_progress(progress)
