"""The stream reasoning coordinator: the node that clients of DyKnow call (VI-A.7)."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import Any, Final, Self

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.srv import CancelEvaluation, EvaluateFormula

from dyknow_common import (
    SECOND_NS,
    DyKnowError,
    ExitCode,
    check_name,
    listed,
    with_readable_times,
)
from dyknow_common.ros import (
    RUNNING,
    Background,
    DyKnowNode,
    ParameterLimits,
    run,
    to_message,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationRequest, is_superseded
from dyknow_coordinator.grounding.source_session import SILENCE_LIMIT_NS, SILENCE_LIMITS_S
from dyknow_coordinator.reporting.evaluation_status import (
    EvaluationStatus,
    Level,
    alarm_level,
    diagnosis_of_ended,
)
from dyknow_coordinator.ros.actions import CancellingActionServer, ClientWatch
from dyknow_coordinator.ros.answers import request_from_message
from dyknow_coordinator.ros.cleanup import Cleanup
from dyknow_coordinator.ros.context import LIMITS, CoordinatorContext, explained_waits
from dyknow_coordinator.ros.evaluation.evaluation_group import EvaluationGroups
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation
from dyknow_coordinator.ros.evaluation.silence_monitor import SilenceMonitor
from dyknow_coordinator.ros.plan_monitoring import PlanMonitoring
from dyknow_coordinator.ros.reporting.changes import follow_changes
from dyknow_coordinator.ros.reporting.evaluations_report import EvaluationsReport
from dyknow_coordinator.ros.reporting.nodes_report import NodesReport
from dyknow_coordinator.ros.reporting.verdict_publishers import VerdictPublishers
from dyknow_coordinator.ros.results import Results
from dyknow_coordinator.ros.service_clients import ServiceClients
from dyknow_coordinator.ros.streams_mirror import StreamsMirror
from dyknow_stream_processing.ros import PAUSES

_STATES: Final = '_states'
"""The beginning of the names of state streams; tools such as `ros2 topic list` hide the topics."""


@dataclass(frozen=True, slots=True)
class _Settings:
    """Parameters of the coordinator, which may change, in seconds."""

    default_timeout_s: Callable[[], float]
    max_timeout_s: Callable[[], float]
    keep_ended_s: Callable[[], float]
    silence_limit_s: Callable[[], float]

    @classmethod
    def declare(cls, node: DyKnowNode) -> Self:
        """Declare the parameters of a node, and return what reads them."""
        return cls(
            default_timeout_s=node.changing_parameter(
                'default_timeout',
                60.0,
                'Seconds for which a formula is evaluated if the client gives no timeout.',
                (0.1, 1e9),
            ),
            max_timeout_s=node.changing_parameter(
                'timeout_limit',
                0.0,
                'Longest timeout in seconds, whatever the client requests; 0: no limit.',
                (0.0, 1e9),
            ),
            keep_ended_s=node.changing_parameter(
                'keep_ended',
                30.0,
                'Seconds for which a formula is reported to operators after its end.',
                (0.0, 1e6),
            ),
            silence_limit_s=node.changing_parameter(
                'silence_limit',
                SILENCE_LIMIT_NS / SECOND_NS,
                'Seconds after which a silent stream is replaced, if others match, and operators '
                'get a warning.',
                SILENCE_LIMITS_S,
            ),
        )


class StreamReasoningCoordinator(DyKnowNode):
    """Answers EvaluateFormula, MonitorFormula and MonitorPlan."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_coordinator')
        PAUSES.start()
        self._settings = _Settings.declare(self)
        own = self.get_fully_qualified_name()
        self._prefix = f'{_STATES}_{zlib.crc32(own.encode()):08x}_'
        limits, background = ParameterLimits(self, LIMITS, CoordinationError), Background(self)
        clients = ServiceClients(self, background)
        self._shared = CoordinatorContext(
            node=self,
            clients=clients,
            streams=StreamsMirror(
                self, clients.streams_topic, clients.streams_namespace, self._on_streams_changed
            ),
            explained_wait=explained_waits(self, clients.federation.name),
            results=Results(self, clients.stream_reasoning_engine.name),
            cleanup=Cleanup(self, clients),
            background=background,
            limits=limits,
            # Unique in the system, also across restarts of this node.
            names=(f'{self._prefix}{self.started_at:x}_{number}' for number in count(1)),
        )
        self._groups = EvaluationGroups(self._shared)
        self._evaluations: list[FormulaEvaluation] = []
        self._service_evaluations: list[FormulaEvaluation] = []
        nodes = NodesReport(self, clients.needed_nodes, lambda: self._shared.streams.engines)
        self._report = EvaluationsReport(
            self, self._statuses, self._settings.silence_limit_s, nodes.diagnostics
        )
        self._verdicts = VerdictPublishers(self, self._named, lambda: limits['verdict_topic_limit'])
        follow_changes(self, clients.version_topics, self._on_semantics_changed)
        SilenceMonitor(self._shared, self._groups, self._settings.silence_limit_s)
        self._follow_nodes(clients)
        self.serve(EvaluateFormula, self._evaluate)
        self.serve(CancelEvaluation, self._cancel)
        self._monitoring = CancellingActionServer(self, MonitorFormula, self._monitor)
        self._plan_monitoring = PlanMonitoring(self, self.start, limits)
        ClientWatch(self, f'{own}/evaluate_formula', self._on_clients_gone)

    def _follow_nodes(self, clients: ServiceClients) -> None:
        for remote in clients.nodes:
            remote.on_found.append(self._update_status)
            remote.on_lost.append(self._update_status)
        clients.stream_reasoning_engine.on_lost.append(self._on_reasoning_engine_lost)
        clients.federation.on_lost.append(self._on_federation_lost)
        self._update_status()

    def destroy_node(self) -> None:
        """Destroy the action servers, then the node."""
        self._monitoring.destroy()
        self._plan_monitoring.server.destroy()
        super().destroy_node()

    def start(self, request: EvaluationRequest) -> FormulaEvaluation:
        """Start to evaluate a formula; its `outcome` will be done in any case.

        Raises:
            DyKnowError: if the name is too long, or too many formulas are evaluated.
        """
        check_name(request.name, CoordinationError)
        self._shared.limits.check(
            'evaluation_limit',
            1 + sum(not each.has_ended for each in self._evaluations),
            'formulas that are evaluated at once',
        )
        evaluation = FormulaEvaluation(self._shared, self._groups, request, self._publish_soon)
        evaluation.on_topics = self._report.publish
        self._evaluations.append(evaluation)
        self._forget_superseded(evaluation)
        self._publish_soon()
        self.spawn(self._run, evaluation)
        return evaluation

    async def _run(self, evaluation: FormulaEvaluation) -> None:
        await evaluation.run()
        self._log_alarm(evaluation)
        self._forget_superseded(evaluation)
        ended = [each for each in self._evaluations if each.has_ended]
        for oldest in ended[: -self._shared.limits['ended_limit']]:
            self._forget(oldest)
        expiry = self.deadlines.after(self._settings.keep_ended_s())
        expiry.add_done_callback(lambda _: self._forget(evaluation))

    def _log_alarm(self, evaluation: FormulaEvaluation) -> None:
        status = evaluation.status()
        level = alarm_level(status, is_monitored=evaluation.request.is_monitored)
        if level is not Level.OK:
            logger = evaluation.logger
            reason = with_readable_times(diagnosis_of_ended(status).text, now=self.now())
            text = f'{status.name}: {reason}'
            # A logger of rclpy has one severity for each call in the code.
            if level is Level.ERROR:
                logger.error(text)
            else:
                logger.warning(text)

    def _forget_superseded(self, later: FormulaEvaluation) -> None:
        if later not in self._evaluations:
            return
        # Not evaluations after it: two that end together must not remove each other.
        for each in self._evaluations[: self._evaluations.index(later)]:
            if is_superseded(each.answer, later.answer) and later.request.repeats(each.request):
                self._forget(each)

    def _forget(self, evaluation: FormulaEvaluation) -> None:
        if evaluation in self._evaluations:
            self._evaluations.remove(evaluation)
            self._publish_soon()

    async def _evaluate(self, request: Any, response: Any) -> None:
        # The client counts the time in which this process was stopped, too.
        delay_s = PAUSES.delay_of(self.request_sent_at()) / SECOND_NS
        evaluation = self.start(replace(self._read_request(request), delay_s=delay_s))
        self._service_evaluations.append(evaluation)
        answer = await evaluation.outcome
        self._service_evaluations.remove(evaluation)
        to_message(answer, response)

    async def _monitor(self, goal: Any) -> Any:
        try:
            request = self._read_request(goal.request)
            evaluation = self.start(replace(request, is_monitored=True, is_followed=True))
        except DyKnowError as error:
            answer = Answer(error=error)
        else:
            evaluation.on_progress = partial(_publish_feedback, goal, evaluation)
            with self._monitoring.running(goal, evaluation.cancel):
                answer = await evaluation.outcome
        result = MonitorFormula.Result()
        to_message(answer, result)
        self._monitoring.finish(goal, answer.error)
        return result

    async def _cancel(self, request: Any, response: Any) -> None:
        running = [each for each in self._evaluations if not each.has_ended]
        named = [each for each in running if request.name in each.names]
        if not named:
            known = listed(dict.fromkeys(each.title for each in running)) or 'none'
            raise CoordinationError(
                f"nothing named '{request.name}' is being evaluated (there are: {known})",
                ExitCode.NOT_FOUND,
            )
        service = f'{self.get_fully_qualified_name()}/cancel_evaluation'
        for each in named:
            self.get_logger().info(f'{each.title}: cancelled by an operator')
            each.cancel(f'cancelled by an operator, who called {service}')
        for each in named:
            await each.outcome
        response.cancelled = len(named)

    def _read_request(self, message: Any) -> EvaluationRequest:
        return request_from_message(
            message, self._settings.default_timeout_s(), self._settings.max_timeout_s()
        )

    def _statuses(self) -> list[EvaluationStatus]:
        return [evaluation.status() for evaluation in self._evaluations]

    def _named(self) -> dict[str, EvaluationStatus]:
        return {each.name: each.status() for each in self._evaluations if each.request.name}

    def _publish_soon(self) -> None:
        self._report.publish_soon()
        self._verdicts.publish_soon()

    def _on_clients_gone(self) -> None:
        for evaluation in list(self._service_evaluations):
            evaluation.cancel('no client of ~/evaluate_formula is left')

    def _on_streams_changed(self) -> None:
        published = self._shared.streams.known.published()
        self._shared.cleanup.destroy_orphans(published, self._prefix)
        for group in self._groups.running():
            group.states.improve()

    def _on_semantics_changed(self) -> None:
        for group in self._groups.running():
            self.spawn(group.update_candidates)
        for evaluation in self._evaluations:
            if evaluation.request.restart_on_change:
                self.spawn(evaluation.update_domains)

    def _on_reasoning_engine_lost(self) -> None:
        for evaluation in list(self._evaluations):
            name = self._shared.clients.stream_reasoning_engine.name
            evaluation.fail_unavailable(f'node {name}')

    def _on_federation_lost(self) -> None:
        """End formulas with parts that peers evaluate: no verdicts on the parts come any more."""
        for evaluation in [each for each in self._evaluations if each.needs_peers]:
            evaluation.fail_unavailable(f'node {self._shared.clients.federation.name}')

    def _update_status(self) -> None:
        missing = [remote.name for remote in self._shared.clients.nodes if not remote.alive]
        if missing:
            self.set_status(f'waiting for {", ".join(missing)}', level=DiagnosticStatus.WARN)
        else:
            self.set_status(RUNNING)


def _publish_feedback(goal: Any, evaluation: FormulaEvaluation) -> None:
    if not evaluation.has_ended:
        goal.publish_feedback(to_message(evaluation.report(), MonitorFormula.Feedback()))


def main() -> int:
    """Run the executable stream_reasoning_coordinator."""
    return run(StreamReasoningCoordinator)
