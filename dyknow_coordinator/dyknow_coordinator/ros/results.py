"""Results and progress reports of the reasoning engine."""

from __future__ import annotations

import secrets
from typing import Any, Final, Protocol

from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress, FormulaResult

from dyknow_common import ExitCode, Verdict
from dyknow_common.ros import (
    LATCHED_HISTORY,
    REPORTS,
    DirectSubscription,
    DyKnowNode,
    only_from,
    only_owner,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError

_MAX_UNCLAIMED: Final = 1000


class ResultListener(Protocol):
    """Receiver of the result and the progress of one formula."""

    def receive_result(self, result: Any) -> None:
        """Receive a FormulaResult message."""

    def receive_progress(self, progress: Any) -> None:
        """Receive a FormulaProgress message."""

    def receive_episodes(self, episodes: Any) -> None:
        """Receive a FormulaEpisodes message."""


class Results:
    """Passes results and progress reports to the listeners of their formulas.

    Args:
        engine: the name of the reasoning engine, whose messages alone are taken.
    """

    def __init__(self, node: DyKnowNode, engine: str) -> None:
        progress_topic, episodes_topic = f'{engine}/progress', f'{engine}/episodes'
        only_engine = only_from(node.resolve_topic_name(progress_topic).removesuffix('/progress'))
        # Each run of the coordinator has its own topic: results of former runs are obsolete.
        run = f'{node.started_at:x}_{secrets.token_hex(8)}'
        self.topic = f'{node.get_fully_qualified_name()}/_results_{run}'
        self._listeners: dict[tuple[int, int], ResultListener] = {}
        # A result may arrive before the response that contains the id of its formula.
        self._unclaimed: dict[tuple[int, int], Any] = {}
        DirectSubscription(
            node,
            FormulaResult,
            self.topic,
            self._on_result,
            LATCHED_HISTORY,
            only_engine,
            callback_group=node.reentrant,
        )
        subscriptions = (
            (FormulaProgress, progress_topic, self._on_progress, REPORTS, only_owner),
            (FormulaEpisodes, episodes_topic, self._on_episodes, LATCHED_HISTORY, only_owner),
        )
        for message_type, topic, callback, quality_of_service, refusal in subscriptions:
            node.create_subscription(
                message_type,
                topic,
                callback,
                quality_of_service,
                callback_group=node.reentrant,
                refusal=refusal,
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

    def _on_result(self, result: Any, _info: object) -> None:
        _check(result)
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

    def _on_episodes(self, episodes: Any) -> None:
        listener = self._listeners.get((episodes.formula_group_id, episodes.formula_id))
        if listener is not None:
            listener.receive_episodes(episodes)


def _check(result: Any) -> None:
    """Check that a FormulaResult is one that a reasoning engine makes.

    Raises:
        ValueError: for a verdict or an exit code that does not exist.
        CoordinationError: for a result that says nothing, or a time before 1970.
    """
    verdict, code = Verdict(result.verdict), ExitCode(result.exit_status.code)
    if (verdict is Verdict.UNDECIDED) == (code is ExitCode.SUCCESS):
        raise CoordinationError(f'it has the verdict {verdict.name} and the exit code {code.name}')
    if time_to_nanoseconds(result.decided_at) < 0:
        raise CoordinationError('it was decided before 1970')
