"""The stream reasoning engine: evaluates groups of formulas over streams of states (VI-A.6)."""

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
from dyknow_common.ros import NO_PUBLISHER_EVENTS, DyKnowNode, run
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.ros.group_evaluation import GroupEvaluation

_LOOK_PERIOD = 0.2


class StreamReasoningEngine(DyKnowNode):
    """Serves the formula groups; evaluates them as their states come."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_engine')
        self._node_limit = self.parameter(
            'node_limit',
            100_000,
            'Most nodes that a formula may grow to by progression before it is given up.',
            (100, 100_000_000),
        )
        period = self.parameter(
            'progress_period',
            1.0,
            'Seconds between two reports on ~/progress, where somebody listens.',
            (0.05, 60.0),
        )
        self._violation_patience = self.parameter(
            'violation_patience',
            5.0,
            'Seconds that a group whose states broke a constraint waits for other states.',
            (0.0, 3600.0),
        )
        self._orphan_limit = self.parameter(
            'orphan_limit',
            10.0,
            'Seconds after which a group is destroyed that nobody asks for and to whose results '
            'nobody listens; 0: never.',
            (0.0, 86_400.0),
        )
        self._groups: dict[int, GroupEvaluation] = {}
        self._ids = count(_first_id(self.born))
        self._progress = self.create_publisher(
            FormulaProgress, '~/progress', 100, event_callbacks=NO_PUBLISHER_EVENTS
        )
        self.create_timer(period, self._report_progress, clock=self.wall_clock)
        self.create_timer(_LOOK_PERIOD, self._look_after_groups, clock=self.wall_clock)
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
        wanted = domains, request.state_stream, request.result_topic
        if evaluation.has_begun:
            evaluation.go_over(*wanted, gap=request.gap)
        else:
            evaluation.begin(*wanted)

    def _destroy(self, request: Any, _response: Any) -> None:
        self._find(request.formula_group_id).end()
        del self._groups[request.formula_group_id]

    def _find(self, group_id: int) -> GroupEvaluation:
        if group_id not in self._groups:
            known = ', '.join(str(known) for known in self._groups) or 'none'
            raise ReasoningError(
                f'there is no formula group {group_id} (there are: {known})', ExitCode.NOT_FOUND
            )
        found = self._groups[group_id]
        found.touch()
        return found

    def _look_after_groups(self) -> None:
        for group_id, evaluation in list(self._groups.items()):
            evaluation.end_patience(self._violation_patience)
            if self._orphan_limit and evaluation.is_orphan(self._orphan_limit):
                self.get_logger().warning(
                    f"the formula group {group_id}, '{evaluation.name}', is destroyed: nobody has "
                    f'asked for it or listened to its results for {self._orphan_limit:g} s'
                )
                evaluation.end()
                del self._groups[group_id]

    def _report_progress(self) -> None:
        if self._progress.get_subscription_count() > 0:
            for evaluation in self._groups.values():
                for report in evaluation.progress_reports():
                    self._progress.publish(report)


def _first_id(born: int) -> int:
    """A number that groups of an engine that had this one's name before are unlikely to have.

    Who asks for a group of the other one gets NOT_FOUND rather than somebody else's group.
    """
    seconds = born // SECOND_NS
    return seconds % 1_000_000 * 1_000 + 1


def main() -> int:
    """The executable stream_reasoning_engine."""
    return run(StreamReasoningEngine)
