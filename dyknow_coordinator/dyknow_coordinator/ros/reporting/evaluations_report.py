"""What operators hear of evaluations: the latched `~/evaluations`, and `/diagnostics`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from dyknow_interfaces.msg import EvaluationStatusArray
from rclpy.qos import QoSProfile

from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED, NO_PUBLISHER_EVENTS, DyKnowNode
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, details, diagnose
from dyknow_coordinator.ros.reporting.evaluation_messages import status_to_message

PERIOD = 1.0
"""Seconds between two reports."""

SETTLING = 0.2
"""Seconds in which changes gather: hundreds of evaluations change together, and all are told."""

DIAGNOSTICS = QoSProfile(depth=1)
"""As those who publish diagnostics do (diagnostic_updater)."""

NO_HARDWARE = 'none'
"""The hardware of diagnostics that concern none, by convention."""


class EvaluationsReport:
    """Publishes what becomes of evaluations, for people and for programs that look on.

    `~/evaluations` comes soon after each change, and each second while anything runs and somebody
    listens; `/diagnostics` comes each second where somebody listens.

    Args:
        statuses: of all evaluations, in the order in which they were asked for.
        silence_limit: seconds without a state after which there is reason to worry.
    """

    def __init__(
        self,
        node: DyKnowNode,
        statuses: Callable[[], Iterable[EvaluationStatus]],
        silence_limit: float = 5.0,
    ) -> None:
        self._node = node
        self._statuses = statuses
        self._silence_limit = round(silence_limit * SECOND_NS)
        self._due = False
        self._evaluations = node.create_publisher(
            EvaluationStatusArray, '~/evaluations', LATCHED, event_callbacks=NO_PUBLISHER_EVENTS
        )
        self._diagnostics = node.create_publisher(
            DiagnosticArray, '/diagnostics', DIAGNOSTICS, event_callbacks=NO_PUBLISHER_EVENTS
        )
        node.create_timer(PERIOD, self._end_period, clock=node.wall_clock)
        # That there are none is told too: then who looks on knows that the coordinator lives.
        self.changed()

    def changed(self) -> None:
        """Has a report published soon; one for many changes that come together."""
        if not self._due:
            self._due = True
            self._node.deadlines.after(SETTLING).add_done_callback(lambda _: self._tell_changes())

    def _end_period(self) -> None:
        # Whoever comes later has the last change at once, and all that is new after a second.
        watched = self._evaluations.get_subscription_count() > 0
        diagnosed = self._diagnostics.get_subscription_count() > 0
        statuses = list(self._statuses()) if watched or diagnosed else []
        if watched and any(status.phase is not EvaluationPhase.ENDED for status in statuses):
            self._publish_evaluations(statuses)
        if diagnosed:
            self._publish_diagnostics(statuses)

    def _tell_changes(self) -> None:
        self._due = False
        self._publish_evaluations(self._statuses())

    def _publish_evaluations(self, statuses: Iterable[EvaluationStatus]) -> None:
        self._evaluations.publish(
            EvaluationStatusArray(
                stamp=self._node.get_clock().now().to_msg(),
                evaluations=[status_to_message(status) for status in statuses],
            )
        )

    def _publish_diagnostics(self, statuses: Iterable[EvaluationStatus]) -> None:
        array = DiagnosticArray(status=list(self._diagnoses(statuses)))
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _diagnoses(self, statuses: Iterable[EvaluationStatus]) -> Iterator[DiagnosticStatus]:
        now, reporter = self._node.now(), self._node.get_fully_qualified_name()
        seen: Counter[str] = Counter()
        for status in statuses:
            seen[status.name] += 1
            # Those who show diagnostics keep one for each name.
            number = f' ({seen[status.name]})' if seen[status.name] > 1 else ''
            diagnosis = diagnose(status, now, self._silence_limit)
            yield DiagnosticStatus(
                level=bytes([diagnosis.level]),
                name=f'{reporter}: {status.name}{number}',
                message=diagnosis.text,
                hardware_id=NO_HARDWARE,
                values=[KeyValue(key=what, value=text) for what, text in details(status)],
            )
