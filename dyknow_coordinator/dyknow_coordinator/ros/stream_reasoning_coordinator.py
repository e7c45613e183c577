"""The stream reasoning coordinator: the one node that a user talks to (VI-A.7)."""

from __future__ import annotations

import zlib
from itertools import count
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import EvaluateFormula

from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus
from dyknow_coordinator.ros.answers import fill_answer, question_from_message
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.change_listener import ChangeListener
from dyknow_coordinator.ros.evaluation.cleanup import Cleanup
from dyknow_coordinator.ros.evaluation.client_watch import ClientWatch
from dyknow_coordinator.ros.evaluation.evaluation_group import EvaluationGroups
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation
from dyknow_coordinator.ros.evaluation.results import Results
from dyknow_coordinator.ros.evaluation.silence_monitor import SilenceMonitor
from dyknow_coordinator.ros.monitor_formula import MonitorFormulaServer
from dyknow_coordinator.ros.plans.plan_monitoring import PlanMonitoring
from dyknow_coordinator.ros.reporting.evaluations_report import EvaluationsReport
from dyknow_coordinator.ros.service_clients import ServiceClients
from dyknow_coordinator.ros.streams_mirror import StreamsMirror


class StreamReasoningCoordinator(DyKnowNode):
    """Answers EvaluateFormula, MonitorFormula and MonitorPlan."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_coordinator')
        self._default_timeout = self.parameter(
            'default_timeout',
            60.0,
            'Seconds that a formula is evaluated for when the caller names no timeout.',
            (0.1, 1e9),
        )
        self._timeout_limit = self.parameter(
            'timeout_limit',
            0.0,
            'Most seconds that a formula is evaluated for, whatever the caller asks; 0: any time.',
            (0.0, 1e9),
        )
        self._keep_ended = self.parameter(
            'keep_ended',
            30.0,
            'Seconds for which operators see a formula after its end.',
            (0.0, 1e6),
        )
        silence_limit = self.parameter(
            'silence_limit',
            5.0,
            'Seconds after which a stream that says nothing is replaced, if others match, and '
            'operators are warned.',
            (0.1, 1e9),
        )
        self._prefix = f'states_{zlib.crc32(self.get_fully_qualified_name().encode()):08x}_'
        clients = ServiceClients(self)
        disposal = Cleanup(self, clients)
        self._facilities = CoordinatorContext(
            node=self,
            clients=clients,
            streams=StreamsMirror(self, clients.streams_topic, self._streams_changed),
            results=Results(self, clients.progress_topic),
            disposal=disposal,
            # Unique in the system, also across restarts of this node.
            names=(f'{self._prefix}{self.born:x}_{number}' for number in count(1)),
        )
        self._groups = EvaluationGroups(self._facilities)
        self._evaluations: list[FormulaEvaluation] = []
        self._asked_by_service: list[FormulaEvaluation] = []
        self._report = EvaluationsReport(self, self._statuses, silence_limit)
        ChangeListener(self, clients.version_topics, self._meanings_changed)
        SilenceMonitor(self._facilities, self._groups, silence_limit)
        for peer in clients.peers:
            peer.on_found.append(self._say_how_it_is)
            peer.on_lost.append(self._say_how_it_is)
        clients.stream_reasoning_engine.on_lost.append(self._reasoning_engine_lost)
        self._say_how_it_is()
        self.serve(EvaluateFormula, self._evaluate)
        self._monitoring = MonitorFormulaServer(self, self.start, self._question)
        self._plan_monitoring = PlanMonitoring(self, self.start)
        service = f'{self.get_fully_qualified_name()}/evaluate_formula'
        ClientWatch(self, service, self._abandon)

    def destroy_node(self) -> None:
        """Frees the action servers too."""
        self._monitoring.destroy()
        self._plan_monitoring.destroy()
        super().destroy_node()

    def start(self, question: EvaluationRequest) -> FormulaEvaluation:
        """Begins to evaluate a formula; its `outcome` is done in any case."""
        evaluation = FormulaEvaluation(
            self._facilities, self._groups, question, self._report.changed
        )
        self._evaluations.append(evaluation)
        self._report.changed()
        self.spawn(self._live, evaluation)
        return evaluation

    async def _live(self, evaluation: FormulaEvaluation) -> None:
        await evaluation.run()
        forgotten = self.deadlines.after(self._keep_ended)
        forgotten.add_done_callback(lambda _: self._forget(evaluation))

    def _forget(self, evaluation: FormulaEvaluation) -> None:
        self._evaluations.remove(evaluation)
        self._report.changed()

    async def _evaluate(self, request: Any, response: Any) -> None:
        evaluation = self.start(self._question(request))
        self._asked_by_service.append(evaluation)
        outcome = await evaluation.outcome
        self._asked_by_service.remove(evaluation)
        fill_answer(response, evaluation, outcome)

    def _question(self, goal: Any) -> EvaluationRequest:
        return question_from_message(goal, self._default_timeout, self._timeout_limit)

    def _statuses(self) -> list[EvaluationStatus]:
        return [evaluation.status() for evaluation in self._evaluations]

    def _abandon(self) -> None:
        for evaluation in list(self._asked_by_service):
            evaluation.cancel('no client of ~/evaluate_formula is left')

    def _streams_changed(self) -> None:
        flowing = self._facilities.streams.known.flowing()
        self._facilities.disposal.end_unwanted(flowing, self._prefix)
        for group in self._groups.running():
            group.states.improve()

    def _meanings_changed(self) -> None:
        for group in self._groups.running():
            self.spawn(group.look_for_streams)
        for evaluation in self._evaluations:
            if evaluation.question.restart_on_change:
                self.spawn(evaluation.look_for_objects)

    def _reasoning_engine_lost(self) -> None:
        for evaluation in list(self._evaluations):
            evaluation.lose(f'node {self._facilities.clients.stream_reasoning_engine.name}')

    def _say_how_it_is(self) -> None:
        missing = [peer.name for peer in self._facilities.clients.peers if not peer.alive]
        if missing:
            self.set_status(f'waiting for {", ".join(missing)}', level=DiagnosticStatus.WARN)
        else:
            self.set_status(RUNNING)


def main() -> int:
    """The executable stream_reasoning_coordinator."""
    return run(StreamReasoningCoordinator)
