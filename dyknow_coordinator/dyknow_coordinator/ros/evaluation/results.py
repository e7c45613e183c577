"""What the reasoning engine tells of formulas, given to those who asked for them."""

from __future__ import annotations

from typing import Any, Final, Protocol

from dyknow_interfaces.msg import FormulaProgress, FormulaResult

from dyknow_common.ros import LATCHED_HISTORY, NO_SUBSCRIPTION_EVENTS, DyKnowNode

_MOST_UNCLAIMED: Final = 1000
_PROGRESS_DEPTH: Final = 1000


class ResultListener(Protocol):
    """Who wants to know of a formula."""

    def receive(self, result: Any) -> None:
        """Takes its result."""

    def note_progress(self, progress: Any) -> None:
        """Takes a report on how far it has come."""


class Results:
    """Receives results and reports, by formula group and formula.

    Args:
        progress_topic: of the reasoning engine.
    """

    def __init__(self, node: DyKnowNode, progress_topic: str) -> None:
        # One for each run: nobody listens to those of a former run, whose groups are ended then.
        self.topic = f'{node.get_fully_qualified_name()}/results_{node.born:x}'
        self._listeners: dict[tuple[int, int], ResultListener] = {}
        # A result may come before the answer that says which formula it is about.
        self._unclaimed: dict[tuple[int, int], Any] = {}
        subscriptions = (
            (FormulaResult, self.topic, self._receive, LATCHED_HISTORY),
            (FormulaProgress, progress_topic, self._note_progress, _PROGRESS_DEPTH),
        )
        for message_type, topic, callback, quality_of_service in subscriptions:
            node.create_subscription(
                message_type,
                topic,
                callback,
                quality_of_service,
                callback_group=node.reentrant,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )

    def claim(self, group_id: int, formula_id: int, listener: ResultListener) -> None:
        """Tells somebody of a formula from now on."""
        key = group_id, formula_id
        self._listeners[key] = listener
        if key in self._unclaimed:
            listener.receive(self._unclaimed.pop(key))

    def release(self, group_id: int, formula_id: int) -> None:
        """Tells nobody of a formula any more."""
        self._listeners.pop((group_id, formula_id), None)

    def _receive(self, result: Any) -> None:
        key = result.formula_group_id, result.formula_id
        if key in self._listeners:
            self._listeners[key].receive(result)
            return
        self._unclaimed[key] = result
        while len(self._unclaimed) > _MOST_UNCLAIMED:
            del self._unclaimed[next(iter(self._unclaimed))]

    def _note_progress(self, progress: Any) -> None:
        listener = self._listeners.get((progress.formula_group_id, progress.formula_id))
        if listener is not None:
            listener.note_progress(progress)
