"""The latched topics `~/verdicts/<name>`: the state of each named formula in numbers, for plots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import nan
from typing import Any, Final

from dyknow_interfaces.msg import FormulaVerdict
from rclpy.exceptions import InvalidTopicNameException

from dyknow_common import Margin, listed
from dyknow_common.ros import (
    LATCHED,
    DyKnowNode,
    RCLError,
    Throttle,
    nanoseconds_to_time,
    to_message,
)
from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus
from dyknow_coordinator.reporting.verdict_topics import NamedVerdict, VerdictTopicNames
from dyknow_coordinator.ros.reporting.changes import ChangeBatch

PERIOD_S: Final = 1.0

COLLECTION_S: Final = 0.05
"""Time in which changes are collected."""

WARNING_PERIOD_S: Final = 60.0
"""Time between two warnings that there are too many topics."""


class VerdictPublishers:
    """Publishes the verdicts of named formulas: soon after each change, and each second.

    Args:
        evaluations: returns the named evaluations that run or ended recently, by unique keys, in
            the order of their requests.
        limit: returns the number of topics.
    """

    def __init__(
        self,
        node: DyKnowNode,
        evaluations: Callable[[], Mapping[str, EvaluationStatus]],
        limit: Callable[[], int],
    ) -> None:
        self._node = node
        self._evaluations = evaluations
        self._limit = limit
        self._names = VerdictTopicNames(limit())
        self._publishers: dict[str, Any] = {}
        self._latest: dict[str, NamedVerdict] = {}
        self._warning = Throttle(WARNING_PERIOD_S)
        self._changes = ChangeBatch(node, COLLECTION_S, partial(self._publish, is_periodic=False))
        publish_all = partial(self._publish, is_periodic=True)
        node.create_timer(PERIOD_S, publish_all, clock=node.wall_clock)

    def publish_soon(self) -> None:
        """Publish what has changed soon."""
        self._changes.add()

    def _publish(self, *, is_periodic: bool) -> None:
        self._names.limit = self._limit()
        statuses = self._names.assign(self._evaluations())
        self._report_missing()
        for token in self._publishers.keys() - statuses.keys():
            self._remove(token)
        for token, status in statuses.items():
            verdict = NamedVerdict.of(status)
            is_due = is_periodic and status.phase is not EvaluationPhase.ENDED
            if is_due or self._latest.get(token) != verdict:
                self._latest[token] = verdict
                if publisher := self._publisher(token):
                    publisher.publish(verdict_to_message(verdict))

    def _report_missing(self) -> None:
        without = self._names.without
        if without and self._warning.is_due():
            self._node.get_logger().warning(
                f'there is no topic for the verdicts of {listed(without)}, as there would be more '
                "than the limit 'verdict_topic_limit' of the coordinator; raise it, or evaluate "
                'fewer formulas with names at once'
            )

    def _publisher(self, token: str) -> Any:
        """Return the publisher of a topic; None if the middleware refuses it."""
        if token not in self._publishers:
            self._publishers[token] = None
            try:
                self._publishers[token] = self._node.create_publisher(
                    FormulaVerdict, f'~/verdicts/{token}', LATCHED
                )
            except (InvalidTopicNameException, RCLError) as error:
                self._node.get_logger().warning(f'there is no topic ~/verdicts/{token}: {error}')
        return self._publishers[token]

    def _remove(self, token: str) -> None:
        self._latest.pop(token, None)
        if publisher := self._publishers.pop(token):
            self._node.destroy_publisher(publisher)


def verdict_to_message(verdict: NamedVerdict) -> FormulaVerdict:
    """Return a FormulaVerdict message."""
    margin = verdict.margin or Margin(nan, nan)
    message = FormulaVerdict(lower_margin=margin.lower, upper_margin=margin.upper)
    to_message(verdict, message)
    message.header.stamp = nanoseconds_to_time(verdict.stamp)
    return message
