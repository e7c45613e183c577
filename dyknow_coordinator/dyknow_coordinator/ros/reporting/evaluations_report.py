"""Reports for operators: the latched topic `~/evaluations`, and `/diagnostics`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from dyknow_interfaces.msg import EvaluationStatusArray

from dyknow_common import SECOND_NS, with_readable_times
from dyknow_common.ros import LATCHED, DiagnosticsPublisher, DyKnowNode
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, details, diagnose
from dyknow_coordinator.ros.reporting.changes import ChangeBatch
from dyknow_coordinator.ros.reporting.evaluation_messages import status_to_message
from dyknow_coordinator.ros.reporting.nodes_report import NO_HARDWARE

PERIOD_S = 1.0

COLLECTION_S = 0.2
"""Time in which changes are collected."""


class EvaluationsReport:
    """Publisher of the status of all evaluations.

    `~/evaluations` is published soon after each change, and each second while there is a
    subscriber; `/diagnostics` each second while there is a subscriber.

    Args:
        statuses: returns the status of all evaluations, in the order of their requests.
        silence_limit_s: returns the time without a state after which operators get a warning.
        nodes: returns the diagnostics of the nodes that the coordinator depends on.
    """

    def __init__(
        self,
        node: DyKnowNode,
        statuses: Callable[[], Iterable[EvaluationStatus]],
        silence_limit_s: Callable[[], float] = lambda: 5.0,
        nodes: Callable[[], Iterable[DiagnosticStatus]] = lambda: (),
    ) -> None:
        self._node = node
        self._statuses = statuses
        self._nodes = nodes
        self._silence_limit_s = silence_limit_s
        self._changes = ChangeBatch(node, COLLECTION_S, self.publish)
        self._evaluations = node.create_publisher(EvaluationStatusArray, '~/evaluations', LATCHED)
        self._diagnostics = DiagnosticsPublisher(node)
        node.create_timer(PERIOD_S, self._publish_periodically, clock=node.wall_clock)
        # Publish an empty report too, so observers know that the coordinator is alive.
        self.publish_soon()

    def publish_soon(self) -> None:
        """Publish a report soon: one for all changes within COLLECTION_S."""
        self._changes.add()

    def publish(self) -> None:
        """Publish a report at once."""
        self._publish_evaluations(self._statuses())

    def _publish_periodically(self) -> None:
        watched = self._evaluations.get_subscription_count() > 0
        diagnosed = self._diagnostics.has_subscribers
        statuses = list(self._statuses()) if watched or diagnosed else []
        if watched:
            self._publish_evaluations(statuses)
        if diagnosed:
            self._diagnostics.publish([*self._nodes(), *self._diagnoses(statuses)])

    def _publish_evaluations(self, statuses: Iterable[EvaluationStatus]) -> None:
        self._evaluations.publish(
            EvaluationStatusArray(
                stamp=self._node.get_clock().now().to_msg(),
                evaluations=[status_to_message(status) for status in statuses],
            )
        )

    def _diagnoses(self, statuses: Iterable[EvaluationStatus]) -> Iterator[DiagnosticStatus]:
        now, reporter = self._node.now(), self._node.get_fully_qualified_name()
        seen: Counter[str] = Counter()
        limit_ns = round(self._silence_limit_s() * SECOND_NS)
        for status in statuses:
            seen[status.name] += 1
            # Tools for diagnostics keep one status for each name.
            number = f' ({seen[status.name]})' if seen[status.name] > 1 else ''
            diagnosis = diagnose(status, now, limit_ns)
            yield DiagnosticStatus(
                level=bytes([diagnosis.level]),
                name=f'{reporter}: {status.name}{number}',
                message=with_readable_times(diagnosis.text, status.started),
                hardware_id=NO_HARDWARE,
                values=[KeyValue(key=name, value=text) for name, text in details(status)],
            )
