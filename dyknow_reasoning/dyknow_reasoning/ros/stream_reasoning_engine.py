"""The stream reasoning engine: evaluates formula groups over state streams (VI-A.6)."""

from __future__ import annotations

from itertools import count
from typing import Any

from dyknow_interfaces.msg import FormulaProgress, Symbol
from dyknow_interfaces.srv import (
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    FormulaGroupExtractSymbols,
    FormulaGroupRemoveFormula,
)

from dyknow_common import SECOND_NS, ExitCode
from dyknow_common.ros import DyKnowNode, run
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.ros.group_evaluation import GroupEvaluation

_SUPERVISION_PERIOD_S = 0.2


class StreamReasoningEngine(DyKnowNode):
    """The node that has the formula groups and evaluates them."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_engine')
        self._node_limit = self.parameter(
            'node_limit',
            100_000,
            'Maximum number of nodes that a formula may grow to by progression before it fails.',
            (100, 100_000_000),
        )
        period = self.parameter(
            'progress_period',
            1.0,
            'Seconds between two reports on ~/progress, if the topic has subscribers.',
            (0.05, 60.0),
        )
        self._violation_patience = self.parameter(
            'violation_patience',
            5.0,
            'Seconds that a group waits for other states after a constraint violation.',
            (0.0, 3600.0),
        )
        self._orphan_limit = self.parameter(
            'orphan_limit',
            10.0,
            'Seconds without a request and without a subscriber to the results after which a group '
            'is destroyed; 0: never.',
            (0.0, 86_400.0),
        )
        self._groups: dict[int, GroupEvaluation] = {}
        self._ids = count(_first_id(self.started_at))
        self._progress = self.create_publisher(FormulaProgress, '~/progress', 100)
        self.create_timer(period, self._report_progress, clock=self.wall_clock)
        self.create_timer(_SUPERVISION_PERIOD_S, self._supervise_groups, clock=self.wall_clock)
        self.serve(FormulaGroupCreate, self._create)
        self.serve(FormulaGroupAddFormula, self._add_formula)
        self.serve(FormulaGroupRemoveFormula, self._remove_formula)
        self.serve(FormulaGroupExtractSymbols, self._extract_symbols)
        self.serve(FormulaGroupEvaluate, self._evaluate)
        self.serve(FormulaGroupDestroy, self._destroy)

    def _create(self, request: Any, response: Any) -> None:
        group_id = next(self._ids)
        group = FormulaGroup(node_limit=self._node_limit)
        self._groups[group_id] = GroupEvaluation(self, group_id, request.formula_group_name, group)
        response.formula_group_id = group_id

    def _add_formula(self, request: Any, response: Any) -> None:
        evaluation = self._find(request.formula_group_id)
        response.formula_id = evaluation.add_formula(request.formula_name, request.formula)
        response.canonical_formula = str(evaluation.group.formulas[response.formula_id])

    def _remove_formula(self, request: Any, _response: Any) -> None:
        self._find(request.formula_group_id).remove_formula(request.formula_id)

    def _extract_symbols(self, request: Any, response: Any) -> None:
        symbols = self._find(request.formula_group_id).group.symbols()
        response.symbols = [
            Symbol(kind=int(symbol.kind), name=symbol.name, arguments=list(symbol.arguments))
            for symbol in symbols
        ]

    def _evaluate(self, request: Any, _response: Any) -> None:
        evaluation = self._find(request.formula_group_id)
        domains = {domain.sort: list(domain.objects) for domain in request.domains}
        arguments = domains, request.state_stream, request.result_topic
        if evaluation.has_begun:
            evaluation.change_stream(*arguments, gap=request.gap)
        else:
            evaluation.begin(*arguments)

    def _destroy(self, request: Any, _response: Any) -> None:
        self._find(request.formula_group_id).destroy()
        del self._groups[request.formula_group_id]

    def _find(self, group_id: int) -> GroupEvaluation:
        if group_id not in self._groups:
            known = ', '.join(str(known) for known in self._groups) or 'none'
            raise ReasoningError(
                f'there is no formula group {group_id} (there are: {known})', ExitCode.NOT_FOUND
            )
        found = self._groups[group_id]
        found.note_request()
        return found

    def _supervise_groups(self) -> None:
        for group_id, evaluation in list(self._groups.items()):
            evaluation.fail_after_pause(self._violation_patience)
            if self._orphan_limit and evaluation.is_orphan(self._orphan_limit):
                self.get_logger().warning(
                    f"the formula group {group_id}, '{evaluation.name}', is destroyed: it had no "
                    f'request and no subscriber to its results for {self._orphan_limit:g} s'
                )
                evaluation.destroy()
                del self._groups[group_id]

    def _report_progress(self) -> None:
        if self._progress.get_subscription_count() > 0:
            for evaluation in self._groups.values():
                for report in evaluation.progress_reports():
                    self._progress.publish(report)


def _first_id(started_at: int) -> int:
    """Return a first group id that differs from the ids of an earlier engine of the same name.

    A request for a group of that engine must fail, not reach another group.
    """
    seconds = started_at // SECOND_NS
    return seconds % 1_000_000 * 1_000 + 1


def main() -> int:
    """Run the executable stream_reasoning_engine."""
    return run(StreamReasoningEngine)
